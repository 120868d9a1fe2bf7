{{- /* What every pod of the platform has: Pod Security restricted, and its place: the component's own, else the platform's.
       Arguments: {root, values}, these the component's. */ -}}
{{- define "robotkube.pod" -}}
enableServiceLinks: false
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  fsGroupChangePolicy: OnRootMismatch
  seccompProfile: {type: RuntimeDefault}
{{- range $key := list "nodeSelector" "tolerations" }}
{{- with get $.values $key | default (get $.root.Values.platform $key) }}
{{ $key }}: {{- toYaml . | nindent 2 }}
{{- end }}
{{- end }}
{{- with .values.affinity }}
affinity: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .values.priorityClassName }}
priorityClassName: {{ . }}
{{- end }}
{{- with .root.Values.imagePullSecrets }}
imagePullSecrets: {{- toYaml . | nindent 2 }}
{{- end }}
{{- end }}

{{- /* Labels and annotations that people set and that belong to the chart, one line each. */ -}}
{{- define "robotkube.podRefusals" -}}
{{- $given := dict "commonLabels" (.Values.commonLabels | default dict) }}
{{- $components := dict }}
{{- range $i, $manager := .Values.managers }}{{ $_ := set $components (printf "managers[%d]" $i) $manager }}{{ end }}
{{- range $name := list "gate" "suites" "broker" "database" "forge" "bootstrap" "teardown" "installationTest" "admission" "inspection" "remover" "rights" "certificates" "console" }}{{ $_ := set $components $name (get $.Values $name | default dict) }}{{ end }}
{{- range $name, $values := $components }}
{{- range $key := list "podLabels" "podAnnotations" }}{{ $_ := set $given (printf "%s.%s" $name $key) (get $values $key | default dict) }}{{ end }}
{{- end }}
{{- range $place, $values := $given }}
{{- range $key, $_ := $values }}
{{- if regexMatch "^(app\\.kubernetes\\.io|helm\\.sh|robotkube\\.io)/" $key }}
{{ printf "%s: %s is set by the chart itself. Use a key of your own, such as example.com/team." $place $key }}
{{- end }}
{{- end }}
{{- end }}
{{- end }}

{{- define "robotkube.container" -}}
imagePullPolicy: IfNotPresent
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
{{- end }}

{{- /* Probes of the platform's processes, at a port whose places clients of the other one cannot take. */ -}}
{{- define "robotkube.probes" -}}
startupProbe: {httpGet: {path: /livez, port: health}, periodSeconds: 1, failureThreshold: 60}
readinessProbe: {httpGet: {path: /readyz, port: health}, periodSeconds: 5, timeoutSeconds: 3, failureThreshold: 2}
livenessProbe: {httpGet: {path: /livez, port: health}, periodSeconds: 20, timeoutSeconds: 5, failureThreshold: 3}
{{- end }}

{{- /* Credentials as a folder inside a projected volume. Argument: {secret, folder}. */ -}}
{{- define "robotkube.credentials" -}}
- secret:
    name: {{ .secret }}
    items:
    - {key: username, path: {{ .folder }}/username}
    - {key: password, path: {{ .folder }}/password}
{{- end }}

{{- /* What the gate shows to the suite-runner. */ -}}
{{- define "robotkube.suiteRunnerToken" -}}
- secret: {name: suite-runner-token, items: [{key: token, path: suite-runner/token}]}
{{- end }}

{{- /* Argument: {name, folder}. */ -}}
{{- define "robotkube.secretFile" -}}
- secret: {name: {{ .name }}, items: [{key: secret, path: {{ .folder }}/secret}]}
{{- end }}
