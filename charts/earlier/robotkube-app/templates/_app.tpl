{{- /*
Argument of both templates:
  root      the chart's scope
  image     key in images.yaml, the file that packing adds
  command   list
  config    the process's settings, a dictionary
  serviceAccount  one of the agent's accounts; empty: application
  broker, database, webhooks  names of Secrets, or empty; mounted at /var/run/secrets/robotkube/<word>
  claims    list of {name, claim, path}
  files     name -> text, beside config.yaml in /etc/robotkube; a changed one restarts the pod, changed settings do not
*/ -}}

{{- define "robotkube-app.configmap" -}}
apiVersion: v1
kind: ConfigMap
metadata:
{{ include "robotkube-app.metadata" .root | indent 2 }}
  {{- with dig "plan" "" (.root.Values.global | default dict) }}
  annotations: {robotkube.io/plan: {{ . | quote }}}     # here alone: a plan that leaves the pod as it is writes no Deployment
  {{- end }}
data:
  config.yaml: |
    {{- toYaml .config | nindent 4 }}
  {{- /* Whose it is: what the process asks itself when it comes back from where nobody could reach it. */}}
  {{- with .root.Values.placement.node }}
  node: {{ . | quote }}
  {{- end }}
  {{- if .root.Values.placement.movable }}
  movable: "true"
  {{- end }}
  {{- range $name, $text := .files }}
  {{ $name }}: {{ toJson $text }}
  {{- end }}
{{- end }}

{{- define "robotkube-app.metadata" -}}
name: {{ .Release.Name | quote }}
labels: {{- include "robotkube-app.labels" . | nindent 2 }}
{{- end }}

{{- define "robotkube-app.labels" -}}
{{ include "robotkube-app.selector" . }}
app.kubernetes.io/part-of: robotkube
app.kubernetes.io/managed-by: {{ .Release.Service }}
robotkube.io/agent: {{ .Values.placement.agent | quote }}
{{- end }}

{{- define "robotkube-app.selector" -}}
app.kubernetes.io/name: {{ .Chart.Name }}
app.kubernetes.io/instance: {{ .Release.Name | quote }}
{{- end }}

{{- define "robotkube-app.image" -}}
{{- $packed := .root.Files.Get "images.yaml" | fromYaml -}}
{{- with get $packed .image -}}
{{ . }}
{{- else -}}
{{ fail (printf "\n\n%s: no image. Pack the chart with images.yaml (key %s).\n" $.root.Chart.Name $.image) }}
{{- end -}}
{{- end }}

{{- define "robotkube-app.deployment" -}}
apiVersion: apps/v1
kind: Deployment
metadata:
{{ include "robotkube-app.metadata" .root | indent 2 }}
spec:
  replicas: 1
  revisionHistoryLimit: 2
  strategy: {type: Recreate}          # two of one kind would double every message
  selector:
    matchLabels: {{- include "robotkube-app.selector" .root | nindent 6 }}
  template:
    metadata:
      labels: {{- include "robotkube-app.labels" .root | nindent 8 }}
      {{- with .files }}
      annotations: {robotkube.io/files: {{ toJson . | sha256sum | trunc 16 | quote }}}
      {{- end }}
    spec: {{- include "robotkube-app.pod" . | nindent 6 }}
{{- end }}

{{- define "robotkube-app.pod" -}}
serviceAccountName: {{ .serviceAccount | default "application" }}
automountServiceAccountToken: false   # mounted below, as the one account this pod needs
enableServiceLinks: false
{{- with .root.Values.terminationGracePeriodSeconds }}
terminationGracePeriodSeconds: {{ . | int }}
{{- end }}
nodeSelector: {robotkube.io/agent: {{ .root.Values.placement.agent | quote }}{{ with .root.Values.placement.node }}, kubernetes.io/hostname: {{ . | quote }}{{ end }}}
dnsConfig: {options: [{name: ndots, value: "1"}]}          # addresses are full names: one question each
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  fsGroupChangePolicy: OnRootMismatch
  seccompProfile: {type: RuntimeDefault}
containers:
- name: {{ .root.Chart.Name }}
  image: {{ include "robotkube-app.image" . | quote }}
  imagePullPolicy: IfNotPresent
  command: {{ toJson .command }}
  env:
  - {name: ROBOTKUBE_CONFIGMAP, value: {{ .root.Release.Namespace }}/{{ .root.Release.Name }}}
  - {name: HOME, value: /tmp}
  - {name: ROS_LOG_DIR, value: /tmp/ros}
  {{- range $name, $value := .environment }}
  - {name: {{ $name }}, value: {{ $value | quote }}}
  {{- end }}
  - {name: NODE_NAME, valueFrom: {fieldRef: {fieldPath: spec.nodeName}}}
  ports: [{name: health, containerPort: 8081}]
  # The start is looked at every second: it is on the way from an event to its recording. Afterwards looking costs more than it tells.
  startupProbe: {httpGet: {path: /readyz, port: health}, periodSeconds: 1, timeoutSeconds: 2, failureThreshold: 300}
  readinessProbe: {httpGet: {path: /readyz, port: health}, periodSeconds: 5, timeoutSeconds: 3, failureThreshold: 2}
  livenessProbe: {httpGet: {path: /livez, port: health}, periodSeconds: 20, timeoutSeconds: 5, failureThreshold: 3}
  resources: {{- toYaml .root.Values.resources | nindent 4 }}
  securityContext:
    allowPrivilegeEscalation: false
    readOnlyRootFilesystem: true
    capabilities: {drop: [ALL]}
  volumeMounts:
  - {name: settings, mountPath: /etc/robotkube, readOnly: true}
  - {name: token, mountPath: /var/run/secrets/kubernetes.io/serviceaccount, readOnly: true}
  {{- with .broker }}
  - {name: broker, mountPath: /var/run/secrets/robotkube/broker, readOnly: true}
  {{- end }}
  {{- with .database }}
  - {name: database, mountPath: /var/run/secrets/robotkube/database, readOnly: true}
  {{- end }}
  {{- with .webhooks }}
  - {name: webhooks, mountPath: /var/run/secrets/robotkube/webhooks, readOnly: true}
  {{- end }}
  {{- range .claims }}
  - {name: {{ .name }}, mountPath: {{ .path }}}
  {{- end }}
  - {name: tmp, mountPath: /tmp}
volumes:
- {name: settings, configMap: {name: {{ .root.Release.Name | quote }}}}
- name: token
  projected:
    defaultMode: 0440
    sources:
    - serviceAccountToken: {path: token, expirationSeconds: 3607}
    - configMap: {name: kube-root-ca.crt, items: [{key: ca.crt, path: ca.crt}]}
    - downwardAPI: {items: [{path: namespace, fieldRef: {fieldPath: metadata.namespace}}]}
{{- range $name, $account := dict "broker" .broker "database" .database }}
{{- with $account }}
- name: {{ $name }}                        # the account, and who may have signed the certificate of what it is for, where that has one
  projected:
    defaultMode: 0440
    sources:
    - secret: {name: {{ . | quote }}}
    - configMap: {name: robotkube-ca, optional: true, items: [{key: ca.crt, path: ca.crt}]}
{{- end }}
{{- end }}
{{- with .webhooks }}
- {name: webhooks, secret: {secretName: {{ . | quote }}, defaultMode: 0440}}
{{- end }}
{{- range .claims }}
- {name: {{ .name }}, persistentVolumeClaim: {claimName: {{ .claim | quote }}}}
{{- end }}
- {name: tmp, emptyDir: {sizeLimit: 256Mi}}
{{- end }}
