{{- /* The values of the process that keeps rights, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.rights" -}}
{{- $defaults := dict "enabled" (eq .Values.broker.kind "mosquitto") }}
{{- $_ := set $defaults "resources" (dict "requests" (dict "cpu" "10m" "memory" "64Mi") "limits" (dict "memory" "192Mi")) }}
{{- range $key, $value := .Values.rights | default dict }}{{ $_ := set $defaults $key $value }}{{ end }}
{{- toJson $defaults }}
{{- end }}

{{- /* Who has an account at the broker besides the observer and the process that keeps rights. */ -}}
{{- define "robotkube.brokerAccounts" -}}
agents:
{{- include "robotkube.agents" . }}
managers:
{{- range fromJsonArray (include "robotkube.managers" .) }}
- {name: {{ .name }}, agents: {{ toJson .scope.agents }}}
{{- end }}
{{- end }}

{{- define "robotkube.rightsSettings" -}}
{{ include "robotkube.listen" . }}
log_level: {{ .Values.logLevel }}
forge:
  {{- include "robotkube.forgeAddress" . | nindent 2 }}
  credentials: /var/run/secrets/robotkube/forge
  deployment: robotkube/deployment
  branch: main
webhook:
  secret: /var/run/secrets/robotkube/webhook/secret
broker:
  {{- include "robotkube.brokerSettings" . | nindent 2 }}
{{ include "robotkube.brokerAccounts" . }}
{{- end }}
