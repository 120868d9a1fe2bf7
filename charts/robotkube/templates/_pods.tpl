{{- /* What every pod of the platform has: Pod Security restricted, and its place. Argument: root. */ -}}
{{- define "robotkube.pod" -}}
enableServiceLinks: false
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  fsGroupChangePolicy: OnRootMismatch
  seccompProfile: {type: RuntimeDefault}
{{- with .Values.platform.nodeSelector }}
nodeSelector: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .Values.platform.tolerations }}
tolerations: {{- toYaml . | nindent 2 }}
{{- end }}
{{- end }}

{{- define "robotkube.container" -}}
imagePullPolicy: IfNotPresent
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
{{- end }}

{{- /* Probes of manager, gate and suite-runner, which serve /livez and /readyz on port 8080. */ -}}
{{- define "robotkube.probes" -}}
startupProbe: {httpGet: {path: /livez, port: http}, periodSeconds: 1, failureThreshold: 60}
readinessProbe: {httpGet: {path: /readyz, port: http}, periodSeconds: 5, timeoutSeconds: 3, failureThreshold: 2}
livenessProbe: {httpGet: {path: /livez, port: http}, periodSeconds: 20, timeoutSeconds: 5, failureThreshold: 3}
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
