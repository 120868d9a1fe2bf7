{{- /* The values of inspection, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.inspection" -}}
{{- $defaults := dict "enabled" true "images" list "otherNamespaces" false "verifyKubelets" true }}
{{- $_ := set $defaults "resources" (dict "requests" (dict "cpu" "20m" "memory" "96Mi") "limits" (dict "memory" "384Mi")) }}
{{- $given := .Values.inspection | default dict }}
{{- range $key, $value := $given }}{{ $_ := set $defaults $key $value }}{{ end }}
{{- toJson $defaults }}
{{- end }}

{{- define "robotkube.inspectorSettings" -}}
{{- $inspection := include "robotkube.inspection" . | fromJson -}}
listen: {address: 0.0.0.0, port: 8081}
log_level: {{ .Values.logLevel }}
forge:
  {{- include "robotkube.forgeAddress" . | nindent 2 }}
  credentials: /var/run/secrets/robotkube/forge
  deployment: robotkube/deployment
  catalogue: robotkube/catalogue
  branch: main
oci_registry:
  charts: {{ include "robotkube.charts" . }}
evidence:
  keys: /etc/robotkube/keys
namespaces:
  agents: [{{ range $i, $agent := .Values.agents }}{{ if $i }}, {{ end }}{{ $agent.name }}{{ end }}]
  tests: [{{ if .Values.suites.enabled }}{{ range $i := until (int .Values.suites.pool) }}{{ if $i }}, {{ end }}{{ include "robotkube.testNamespace" $i }}{{ end }}{{ end }}]
  platform: {{ .Release.Namespace }}
  gate: {{ include "robotkube.gateNamespace" . }}
  argocd: {{ .Values.argocd.namespace }}
  others: {{ $inspection.otherNamespaces }}
images:
{{- $images := list }}
{{- range $name, $reference := .Values.images }}{{ if and $reference (or (ne $name "mongo") (eq (include "robotkube.suitesDatabase" $) "mongo")) }}{{ $images = append $images (include "robotkube.image" (dict "root" $ "name" $name)) }}{{ end }}{{ end }}
{{- range concat $images $inspection.images | uniq | sortAlpha }}
- {{ . }}
{{- end }}
kubelets: {verify: {{ $inspection.verifyKubelets }}}
{{- end }}
