{{- define "event-detector.app" -}}
image: event-detector
command: [robotkube-event-detector]
settings: watched
serviceAccount: event-detector
broker: {{ (.Values.broker).existingSecret | default "" | quote }}
database: {{ (.Values.database).existingSecret | default "" | quote }}
webhooks: {{ (.Values.webhooks).existingSecret | default "" | quote }}
environment: {ROBOTKUBE_REACTIONS: /tmp/reactions}      # outlives the container, not the pod
claims:
{{- with (.Values.recordings).claim }}
- {name: recordings, claim: {{ . | quote }}, path: /var/lib/robotkube/recordings}
{{- end }}
{{- with (.Values.bags).claim }}
- {name: bags, claim: {{ . | quote }}, path: /var/lib/robotkube/bags}
{{- end }}
config:
  name: {{ .Release.Namespace }}/{{ .Release.Name }}
  topics: {{ toJson ((.Values.detector).topics | default list) }}
  rules: {{ toJson ((.Values.detector).rules | default list) }}
  reactions: {{ toJson ((.Values.detector).reactions | default list) }}
  task: {{ (.Values.detector).task | default "" | quote }}
  state: {{ (.Values.detector).state | default "active" }}
  buffer: {{ toJson ((.Values.detector).buffer | default dict) }}
{{- end }}
