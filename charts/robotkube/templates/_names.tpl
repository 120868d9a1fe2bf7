{{- /* Labels of every object. Arguments: {root, component} and, where objects of a component have names of their own, name. */ -}}
{{- define "robotkube.labels" -}}
{{ include "robotkube.sharedLabels" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
helm.sh/chart: {{ .root.Chart.Name }}-{{ .root.Chart.Version }}
{{- with .root.Values.commonLabels }}
{{ toYaml . }}
{{- end }}
{{- end }}

{{- /* Labels of a component's pods. Their version is that of the image, and the chart's is missing: a pod starts anew when another
       program shall run in it, not with every version of the chart. Arguments: as above, {image} and {values}, the component's own. */ -}}
{{- define "robotkube.podLabels" -}}
{{ include "robotkube.sharedLabels" . }}
app.kubernetes.io/version: {{ include "robotkube.imageVersion" .image | quote }}
{{- with merge (dict) (.values.podLabels | default dict) (.root.Values.commonLabels | default dict) }}
{{ toYaml . }}
{{- end }}
{{- end }}

{{- /* What labels of objects and of pods have in common. */ -}}
{{- define "robotkube.sharedLabels" -}}
{{ include "robotkube.selector" . }}
app.kubernetes.io/component: {{ .component }}
app.kubernetes.io/part-of: robotkube
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
{{- end }}

{{- /* Part of `spec.selector`, which never changes: an upgrade would fail on it. */ -}}
{{- define "robotkube.selector" -}}
app.kubernetes.io/name: {{ .name | default .component }}
app.kubernetes.io/instance: {{ .root.Release.Name }}
{{- end }}

{{- /* The reference of an image of the values, by the name that it has there; with global.imageRegistry what stands before its last
       slash is that instead. Arguments: {root, name}. */ -}}
{{- define "robotkube.image" -}}
{{- $reference := index .root.Values.images .name | default "" -}}
{{- $registry := dig "imageRegistry" "" (.root.Values.global | default dict) -}}
{{- if and $registry $reference }}{{ trimSuffix "/" $registry }}/{{ regexReplaceAll "^.*/" $reference "" }}{{ else }}{{ $reference }}{{ end -}}
{{- end }}

{{- /* The tag of an image, else the first 12 digits of its digest, as a label. Argument: the reference. */ -}}
{{- define "robotkube.imageVersion" -}}
{{- $tag := regexReplaceAll "@.*$" . "" | regexFind ":[^:/]+$" | trimPrefix ":" -}}
{{- $digest := regexFind "@[a-z0-9]+:[0-9a-f]{1,12}" . | splitList ":" | last -}}
{{- $tag | default $digest | default "latest" | trunc 63 | trimAll "._-" -}}
{{- end }}

{{- /* Full name of a Service: one DNS question, no search list. Argument: {root, name} and, optional, namespace. */ -}}
{{- define "robotkube.host" -}}
{{ .name }}.{{ .namespace | default .root.Release.Namespace }}.svc.{{ .root.Values.clusterDomain }}
{{- end }}

{{- define "robotkube.gateHost" -}}
{{ include "robotkube.host" (dict "root" . "name" "gate" "namespace" (include "robotkube.gateNamespace" .)) }}
{{- end }}

{{- define "robotkube.forgeHost" -}}
{{- if eq .Values.forge.kind "external" -}}
{{ regexReplaceAll "^https?://" .Values.forge.external.url "" }}
{{- else -}}
{{ include "robotkube.host" (dict "root" . "name" "forge") }}:3000
{{- end -}}
{{- end }}

{{- /* One address for Git, web links, OCI registry and Argo CD. */ -}}
{{- define "robotkube.forgeUrl" -}}
{{- if eq .Values.forge.kind "external" -}}
{{ .Values.forge.external.url }}
{{- else -}}
{{ include "robotkube.forgeEncrypted" . | eq "true" | ternary "https" "http" }}://{{ include "robotkube.forgeHost" . }}
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
{{- with include "robotkube.forgeAuthorities" . }}
{{ . }}
{{- end }}
{{- end }}

{{- /* An organisation of the OCI registry. Argument: {root, organisation}. */ -}}
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
{{ eq .Values.broker.kind "external" | ternary .Values.broker.external.port (include "robotkube.encrypted" . | eq "true" | ternary 8883 1883) | int }}
{{- end }}

{{- define "robotkube.databaseHost" -}}
{{ eq .Values.database.kind "external" | ternary .Values.database.external.host (include "robotkube.host" (dict "root" . "name" "database")) }}
{{- end }}

{{- define "robotkube.databasePort" -}}
{{ eq .Values.database.kind "external" | ternary .Values.database.external.port (include "robotkube.databaseEncrypted" . | eq "true" | ternary 27018 27017) | int }}
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
- {name: {{ .name }}, {{ if .reserved }}reserved: true{{ else }}role: {{ .role }}{{ end }}, namespace: {{ .name }}, records: {{ .records | default false }}}
{{- else }} []
{{- end }}
{{- end }}

{{- /* Names of the agents that main may enroll, separated by commas. */ -}}
{{- define "robotkube.reservedAgents" -}}
{{- $found := list }}
{{- range .Values.agents }}{{ if .reserved }}{{ $found = append $found .name }}{{ end }}{{ end }}
{{- join ", " $found -}}
{{- end }}

{{- /* Kept on uninstall when something in it is kept: a Namespace that goes takes its volume claims along. Argument: an agent. */ -}}
{{- define "robotkube.agentKeeps" -}}
{{- if or .records .claims }}true{{ end -}}
{{- end }}
