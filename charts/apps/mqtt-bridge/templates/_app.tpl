{{- define "mqtt-bridge.app" -}}
image: mqtt-bridge
command: [robotkube-bridge]
settings: watched
serviceAccount: mqtt-bridge
broker: {{ (.Values.broker).existingSecret | required "\n\nmqtt-bridge: no account at the broker. Give broker.existingSecret.\n" | quote }}
config:
  agent: {{ .Values.placement.agent | quote }}
  out: {{ toJson ((.Values.bridge).out | default list) }}
  in: {{ toJson ((.Values.bridge).in | default list) }}
  trace: {{ (.Values.bridge).trace | default "" | quote }}
  publish_types: {{ (.Values.bridge).publish_types | default false }}
  publish_gaps: {{ dig "publish_gaps" true (.Values.bridge | default dict) }}
{{- end }}
