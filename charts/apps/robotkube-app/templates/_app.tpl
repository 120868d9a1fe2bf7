{{- /*
Argument of both templates:
  root      the chart's scope
  image     key in images.yaml, the file that packing adds
  command   list
  config    the process's settings, a dictionary
  serviceAccount  one of the agent's accounts; empty: application
  broker, database, webhooks  names of Secrets, or empty; mounted at /var/run/secrets/robotkube/<word>
  claims    list of {name, claim, path}
  files     name -> text, beside config.yaml in /etc/robotkube; a changed one restarts the pod
  settings  how the process takes changed settings: watched (it follows its ConfigMap, the pod stays) or restart (the pod
            template has their hash, so that a change is a new pod); empty: watched
  results   the question of the readiness probe once the process has started (exec or httpGet, as Kubernetes writes it),
            for a chart whose results are more than its being ready; empty: /readyz
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

{{- /* Labels of every object. */ -}}
{{- define "robotkube-app.labels" -}}
{{ include "robotkube-app.sharedLabels" . }}
app.kubernetes.io/version: {{ .Chart.AppVersion | default .Chart.Version | quote }}
{{- end }}

{{- /* Labels of the pod. Their version is that of the image: a pod starts anew when another program shall run in it, not with every
       version of the chart. Argument: that of the Deployment. */ -}}
{{- define "robotkube-app.podLabels" -}}
{{ include "robotkube-app.sharedLabels" .root }}
app.kubernetes.io/version: {{ include "robotkube-app.image" . | include "robotkube-app.imageVersion" | quote }}
{{- end }}

{{- define "robotkube-app.sharedLabels" -}}
{{ include "robotkube-app.selector" . }}
app.kubernetes.io/component: application-service
app.kubernetes.io/part-of: robotkube
app.kubernetes.io/managed-by: {{ .Release.Service }}
robotkube.io/agent: {{ .Values.placement.agent | required (printf "\n\n%s: no agent. Give placement.agent.\n" .Chart.Name) | quote }}
{{- end }}

{{- /* The tag of an image, else the first 12 digits of its digest, as a label. Argument: the reference. */ -}}
{{- define "robotkube-app.imageVersion" -}}
{{- $tag := regexReplaceAll "@.*$" . "" | regexFind ":[^:/]+$" | trimPrefix ":" -}}
{{- $digest := regexFind "@[a-z0-9]+:[0-9a-f]{1,12}" . | splitList ":" | last -}}
{{- $tag | default $digest | default "latest" | trunc 63 | trimAll "._-" -}}
{{- end }}

{{- /* Part of `spec.selector`, which never changes: an upgrade would fail on it. */ -}}
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
      labels: {{- include "robotkube-app.podLabels" . | nindent 8 }}
      {{- with include "robotkube-app.podAnnotations" . | fromYaml }}
      annotations: {{- toYaml . | nindent 8 }}
      {{- end }}
    spec: {{- include "robotkube-app.pod" . | nindent 6 }}
{{- end }}

{{- /* Hashes of what the pod reads at its start alone. Argument: that of the Deployment. */ -}}
{{- define "robotkube-app.podAnnotations" -}}
{{- with .files }}
robotkube.io/files: {{ toJson . | sha256sum | trunc 16 | quote }}
{{- end }}
{{- if eq (.settings | default "") "restart" }}
robotkube.io/settings: {{ toJson .config | sha256sum | trunc 16 | quote }}
{{- else if and .settings (ne .settings "watched") }}
{{ fail (printf "\n\n%s: settings %q. Write watched or restart in templates/_app.tpl.\n" .root.Chart.Name .settings) }}
{{- end }}
{{- end }}

{{- /* The label of the agent's Nodes; where it is a guest on another agent's, that of its own there. */ -}}
{{- define "robotkube-app.ofAgent" -}}
{{- with .Values.placement.guest -}}
agent.robotkube.io/{{ $.Values.placement.agent }}: {{ int . | quote }}
{{- else -}}
robotkube.io/agent: {{ .Values.placement.agent | quote }}
{{- end -}}
{{- end }}

{{- define "robotkube-app.pod" -}}
serviceAccountName: {{ .serviceAccount | default "application" }}
automountServiceAccountToken: false   # mounted below, as the one account this pod needs
enableServiceLinks: false
{{- with .root.Values.terminationGracePeriodSeconds }}
terminationGracePeriodSeconds: {{ . | int }}
{{- end }}
nodeSelector: { {{- include "robotkube-app.ofAgent" .root }}{{ with .root.Values.placement.node }}, kubernetes.io/hostname: {{ . | quote }}{{ end -}} }
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
  {{- with .root.Values.placement.guest }}
  - {name: ROS_DOMAIN_ID, value: {{ int . | quote }}}          # its host's pods, and those of other guests, are on the same network
  {{- end }}
  - {name: NODE_NAME, valueFrom: {fieldRef: {fieldPath: spec.nodeName}}}
  ports: [{name: health, containerPort: 8081}]
  # The start is looked at every second: it is on the way from an event to its recording. Afterwards looking costs more than it tells.
  startupProbe: {httpGet: {path: /readyz, port: health}, periodSeconds: 1, timeoutSeconds: 2, failureThreshold: 300}
  {{- with .results }}
  readinessProbe: {{ dict "periodSeconds" 5 "timeoutSeconds" 3 "failureThreshold" 2 | merge (deepCopy .) | toJson }}
  {{- else }}
  readinessProbe: {httpGet: {path: /readyz, port: health}, periodSeconds: 5, timeoutSeconds: 3, failureThreshold: 2}
  {{- end }}
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
