{{- define "robotkube.agentLabels" -}}
{{ include "robotkube.labels" (dict "root" .root "component" "agent") }}
robotkube.io/agent: {{ .agent.name }}
{{- end }}

{{- define "robotkube.databaseAccount" -}}
username: {{ include "robotkube.database" .agent.name }}
password: {{ include "robotkube.password" (dict "root" .root "purpose" "database" "account" .agent.name) }}
database: {{ include "robotkube.database" .agent.name }}
authenticationDatabase: {{ include "robotkube.database" .agent.name }}
host: {{ include "robotkube.databaseHost" .root }}
port: {{ include "robotkube.databasePort" .root | quote }}
{{- end }}

{{- define "robotkube.brokerAccount" -}}
username: {{ .agent.name }}
password: {{ include "robotkube.password" (dict "root" .root "purpose" "broker" "account" .agent.name) }}
host: {{ include "robotkube.brokerHost" .root }}
port: {{ include "robotkube.brokerPort" .root | quote }}
{{- end }}
