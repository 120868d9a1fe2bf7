{{- /* Digests of the platform's images, as keys. Helm writes them, not the process: its own pod has to be among them first. */ -}}
{{- define "robotkube.platformDigests" -}}
{{- range .Values.images }}{{ if contains "@sha256:" . }}
platform.{{ regexFind "@sha256:[0-9a-f]+" . | trimPrefix "@sha256:" }}: ""
{{- end }}{{ end }}
{{- end }}

{{- /* What admission is told by the values; filled in where an upgrade reuses older ones. */ -}}
{{- define "robotkube.admissionResources" -}}
{{- toYaml (.Values.admission.resources | default (dict "requests" (dict "cpu" "20m" "memory" "96Mi") "limits" (dict "memory" "256Mi"))) }}
{{- end }}

{{- define "robotkube.admissionSettings" -}}
{{- $agents := list }}{{ range .Values.agents }}{{ $agents = append $agents .name }}{{ end }}
{{- $tests := list }}
{{- if .Values.suites.enabled }}{{ range $i := until (int .Values.suites.pool) }}{{ $tests = append $tests (include "robotkube.testNamespace" $i) }}{{ end }}{{ end -}}
{{ include "robotkube.listen" . }}
log_level: {{ .Values.logLevel }}
forge:
  {{- include "robotkube.forgeAddress" . | nindent 2 }}
  credentials: /var/run/secrets/robotkube/forge
  catalogue: robotkube/catalogue
  branch: main
oci_registry:
  charts: {{ include "robotkube.charts" . }}
webhook:
  secret: /var/run/secrets/robotkube/webhook/secret
evidence:
  keys: /etc/robotkube/keys
platform_namespace: {{ .Release.Namespace }}
gate_namespace: {{ include "robotkube.gateNamespace" . }}
argocd: {namespace: {{ .Values.argocd.namespace }}}
agents: {{ toJson $agents }}
test_namespaces: {{ toJson $tests }}
remover: {{ (include "robotkube.remover" . | fromJson).enabled }}
{{- end }}
