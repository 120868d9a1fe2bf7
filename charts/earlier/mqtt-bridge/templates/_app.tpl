{{- define "mqtt-bridge.app" -}}
image: ros
command: [robotkube-bridge]
serviceAccount: mqtt-bridge
broker: {{ .Values.broker.existingSecret }}
config:
  agent: {{ .Values.placement.agent }}
  out: {{ toJson .Values.bridge.out }}
  in: {{ toJson .Values.bridge.in }}
{{- end }}
