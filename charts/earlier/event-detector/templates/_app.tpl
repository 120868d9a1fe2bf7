{{- define "event-detector.app" -}}
image: ros
command: [robotkube-event-detector]
serviceAccount: event-detector
database: {{ .Values.database.existingSecret | quote }}
{{- with .Values.recordings.claim }}
claims: [{name: recordings, claim: {{ . }}, path: /var/lib/robotkube/recordings}]
{{- end }}
config:
  name: {{ .Release.Namespace }}/{{ .Release.Name }}
  topics: {{ toJson .Values.detector.topics }}
  rules: {{ toJson .Values.detector.rules }}
  reactions: {{ toJson .Values.detector.reactions }}
  task: {{ .Values.detector.task | quote }}
{{- end }}
