{{- define "mqtt-bridge.app" -}}
image: ros
command: [python3, -m, robotkube.entrypoints.bridge]
serviceAccount: mqtt-bridge
broker: {{ .Values.broker.existingSecret }}
config:
  agent: {{ .Values.placement.agent }}
  out: {{ toJson .Values.bridge.out }}
  in: {{ toJson .Values.bridge.in }}
  trace: {{ .Values.bridge.trace | quote }}
  publish_types: {{ .Values.bridge.publish_types }}
  publish_gaps: {{ .Values.bridge.publish_gaps }}
{{- end }}
