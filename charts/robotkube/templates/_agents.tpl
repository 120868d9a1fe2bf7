{{- define "robotkube.agentLabels" -}}
{{ include "robotkube.labels" (dict "root" .root "component" "agent") }}
robotkube.io/agent: {{ .agent.name }}
{{- end }}

{{- /* Service accounts that releases run as; `application` is that of charts without an account of their own. */ -}}
{{- define "robotkube.applicationAccounts" -}}
application mqtt-bridge event-detector bag-player
{{- end }}

{{- /* The accounts, and their right to read the settings of their own namespace. Arguments: {root, namespace, labels}. */ -}}
{{- define "robotkube.applicationServiceAccounts" -}}
{{- range splitList " " (include "robotkube.applicationAccounts" .root) }}
---
apiVersion: v1
kind: ServiceAccount
metadata:
  name: {{ . }}
  namespace: {{ $.namespace }}
  labels: {{- $.labels | nindent 4 }}
automountServiceAccountToken: false
{{- end }}
{{- end }}

{{- define "robotkube.configurationReader" -}}
---
apiVersion: rbac.authorization.k8s.io/v1
kind: Role
metadata:
  name: configuration-reader
  namespace: {{ .namespace }}
  labels: {{- .labels | nindent 4 }}
rules:
- apiGroups: [""]
  resources: [configmaps]
  verbs: [get, list, watch]
{{- end }}

{{- define "robotkube.configurationReaders" -}}
---
apiVersion: rbac.authorization.k8s.io/v1
kind: RoleBinding
metadata:
  name: configuration-reader
  namespace: {{ .namespace }}
  labels: {{- .labels | nindent 4 }}
roleRef: {apiGroup: rbac.authorization.k8s.io, kind: Role, name: configuration-reader}
subjects:
{{- range splitList " " (include "robotkube.applicationAccounts" .root) }}
- {kind: ServiceAccount, name: {{ . }}, namespace: {{ $.namespace }}}
{{- end }}
{{- end }}

{{- define "robotkube.databaseAccount" -}}
username: {{ include "robotkube.database" .agent.name }}
password: {{ include "robotkube.password" (dict "root" .root "purpose" "database" "account" .agent.name) }}
database: {{ include "robotkube.database" .agent.name }}
authenticationDatabase: {{ include "robotkube.database" .agent.name }}
host: {{ include "robotkube.databaseHost" .root }}
port: {{ include "robotkube.databasePort" .root | quote }}
tls: {{ include "robotkube.databaseEncrypted" .root | eq "true" | ternary "required" "off" | quote }}
{{- end }}

{{- /* An agent's password at the broker: of its name, and of its number once that was raised. Arguments: {root, agent}. */ -}}
{{- define "robotkube.agentBrokerPassword" -}}
{{- $number := int (.agent.brokerPasswordNumber | default 0) }}
{{- $account := gt $number 0 | ternary (printf "%s/%d" .agent.name $number) .agent.name }}
{{- include "robotkube.password" (dict "root" .root "purpose" "broker" "account" $account) }}
{{- end }}

{{- define "robotkube.brokerAccount" -}}
username: {{ .agent.name }}
password: {{ include "robotkube.agentBrokerPassword" . }}
{{ include "robotkube.brokerEndpoint" .root }}
{{- end }}

{{- /* The values of installationTest, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.installationTest" -}}
{{- toJson (merge (dict) (.Values.installationTest | default dict) (dict "agent" "" "application" "pose-point-cloud-recording" "parameters" dict)) }}
{{- end }}

{{- /* The agent in whose name the installation is tried: the first that records; none where its account of the database is not of the
       chart's making. */ -}}
{{- define "robotkube.testAgent" -}}
{{- $found := list }}
{{- if ne .Values.database.kind "external" }}
{{- range .Values.agents }}{{ if and .records (not .reserved) }}{{ $found = append $found .name }}{{ end }}{{ end }}
{{- end }}
{{- if $found }}{{ (include "robotkube.installationTest" . | fromJson).agent | default (first $found) }}{{ end -}}
{{- end }}

{{- /* The parameters of its task: as given, else the first agent of role vehicle. JSON. */ -}}
{{- define "robotkube.testParameters" -}}
{{- $parameters := (include "robotkube.installationTest" . | fromJson).parameters | default dict }}
{{- $vehicles := list }}
{{- range .Values.agents }}{{ if eq (.role | default "") "vehicle" }}{{ $vehicles = append $vehicles .name }}{{ end }}{{ end }}
{{- if and $vehicles (not $parameters) }}{{ $parameters = dict "vehicles" (list (first $vehicles)) }}{{ end -}}
{{ toJson $parameters }}
{{- end }}

{{- /* What is wrong with installationTest, one line. */ -}}
{{- define "robotkube.installationTestRefusals" -}}
{{- $wanted := (include "robotkube.installationTest" . | fromJson).agent }}
{{- $recording := list }}
{{- range .Values.agents }}{{ if .records }}{{ $recording = append $recording .name }}{{ end }}{{ end }}
{{- if and $wanted (not (has $wanted $recording)) }}
{{ printf "installationTest.agent %q: no agent of this name records. Name one with records: true, or leave it out." $wanted }}
{{- end }}
{{- end }}
