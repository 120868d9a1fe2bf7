{{- /* The values of remover, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.remover" -}}
{{- $defaults := dict "enabled" false "pods" true "workloads" true "perMinute" 20 }}
{{- $_ := set $defaults "resources" (dict "requests" (dict "cpu" "10m" "memory" "48Mi") "limits" (dict "memory" "128Mi")) }}
{{- range $key, $value := .Values.remover | default dict }}{{ $_ := set $defaults $key $value }}{{ end }}
{{- toJson $defaults }}
{{- end }}

{{- define "robotkube.removerSettings" -}}
{{- $remover := include "robotkube.remover" . | fromJson -}}
listen: {address: 0.0.0.0, port: 8081}
log_level: {{ .Values.logLevel }}
namespace: {{ .Release.Namespace }}
agents: [{{ range $i, $agent := .Values.agents }}{{ if $i }}, {{ end }}{{ $agent.name }}{{ end }}]
pods: {{ $remover.pods }}
workloads: {{ $remover.workloads }}
per_minute: {{ $remover.perMinute | int }}
{{- end }}
