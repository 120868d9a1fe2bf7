{{- /* Labels of every object. Argument: {root, component}. */ -}}
{{- define "robotkube.labels" -}}
{{ include "robotkube.selector" . }}
app.kubernetes.io/part-of: robotkube
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
helm.sh/chart: {{ .root.Chart.Name }}-{{ .root.Chart.Version }}
{{- end }}

{{- define "robotkube.selector" -}}
app.kubernetes.io/name: {{ .component }}
app.kubernetes.io/instance: {{ .root.Release.Name }}
{{- end }}

{{- /* Full name of a Service: one DNS question, no search list. Argument: {root, name} and, optional, namespace. */ -}}
{{- define "robotkube.host" -}}
{{ .name }}.{{ .namespace | default .root.Release.Namespace }}.svc.{{ .root.Values.clusterDomain }}
{{- end }}

{{- define "robotkube.forgeHost" -}}
{{- if eq .Values.forge.kind "external" -}}
{{ regexReplaceAll "^https?://" .Values.forge.external.url "" }}
{{- else -}}
{{ include "robotkube.host" (dict "root" . "name" "forge") }}:3000
{{- end -}}
{{- end }}

{{- /* One address for Git, web links, registry and Argo CD. */ -}}
{{- define "robotkube.forgeUrl" -}}
{{- if eq .Values.forge.kind "external" -}}
{{ .Values.forge.external.url }}
{{- else -}}
http://{{ include "robotkube.forgeHost" . }}
{{- end -}}
{{- end }}

{{- /* How manager and gate reach the forge, in their settings. */ -}}
{{- define "robotkube.forgeAddress" -}}
url: {{ include "robotkube.forgeUrl" . }}
{{- if and (eq .Values.forge.kind "external") (ne .Values.forge.external.protocol "gitea") }}
kind: {{ .Values.forge.external.protocol }}
{{- with .Values.forge.external.api }}
api: {{ . }}
{{- end }}
{{- end }}
{{- end }}

{{- /* An organisation of the registry. Argument: {root, organisation}. */ -}}
{{- define "robotkube.packages" -}}
oci://{{ include "robotkube.forgeHost" .root }}/{{ .organisation }}
{{- end }}

{{- /* The only charts that may run: what the gate published. */ -}}
{{- define "robotkube.charts" -}}
{{ include "robotkube.packages" (dict "root" . "organisation" "verified") }}
{{- end }}

{{- define "robotkube.brokerHost" -}}
{{ eq .Values.broker.kind "external" | ternary .Values.broker.external.host (include "robotkube.host" (dict "root" . "name" "broker")) }}
{{- end }}

{{- define "robotkube.brokerPort" -}}
{{ eq .Values.broker.kind "external" | ternary .Values.broker.external.port 1883 | int }}
{{- end }}

{{- define "robotkube.databaseHost" -}}
{{ eq .Values.database.kind "external" | ternary .Values.database.external.host (include "robotkube.host" (dict "root" . "name" "database")) }}
{{- end }}

{{- define "robotkube.databasePort" -}}
{{ eq .Values.database.kind "external" | ternary .Values.database.external.port 27017 | int }}
{{- end }}

{{- define "robotkube.hookUrl" -}}
http://{{ include "robotkube.host" (dict "root" . "name" "argocd-applicationset-controller" "namespace" .Values.argocd.namespace) }}:7000/api/webhook
{{- end }}

{{- /* ROS names take no hyphen. */ -}}
{{- define "robotkube.ros" -}}
{{ . | replace "-" "_" }}
{{- end }}

{{- define "robotkube.database" -}}
recordings_{{ include "robotkube.ros" . }}
{{- end }}

{{- /* The agents, as the settings files list them. */ -}}
{{- define "robotkube.agents" -}}
{{- range .Values.agents }}
- {name: {{ .name }}, role: {{ .role }}, namespace: {{ .name }}, records: {{ .records | default false }}}
{{- else }} []
{{- end }}
{{- end }}

{{- /* Kept on uninstall when something in it is kept: a Namespace that goes takes its claims along. Argument: an agent. */ -}}
{{- define "robotkube.agentKeeps" -}}
{{- if or .records .claims }}true{{ end -}}
{{- end }}
