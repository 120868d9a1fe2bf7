{{- define "event-detector.app" -}}
image: ros
command: [python3, -m, robotkube.entrypoints.detector]
serviceAccount: event-detector
broker: {{ .Values.broker.existingSecret | quote }}
database: {{ .Values.database.existingSecret | quote }}
webhooks: {{ .Values.webhooks.existingSecret | quote }}
environment: {ROBOTKUBE_REACTIONS: /tmp/reactions}      # outlives the container, not the pod
claims:
{{- with .Values.recordings.claim }}
- {name: recordings, claim: {{ . }}, path: /var/lib/robotkube/recordings}
{{- end }}
{{- with .Values.bags.claim }}
- {name: bags, claim: {{ . }}, path: /var/lib/robotkube/bags}
{{- end }}
config:
  name: {{ .Release.Namespace }}/{{ .Release.Name }}
  topics: {{ toJson .Values.detector.topics }}
  rules: {{ toJson .Values.detector.rules }}
  reactions: {{ toJson .Values.detector.reactions }}
  task: {{ .Values.detector.task | quote }}
  state: {{ .Values.detector.state }}
  buffer: {{ toJson .Values.detector.buffer }}
{{- end }}
