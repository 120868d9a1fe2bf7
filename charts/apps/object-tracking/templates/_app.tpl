{{- define "object-tracking.app" -}}
image: object-tracking
command: [robotkube-object-tracking]
settings: watched
config:
  objects: {{ .Values.tracking.objects }}
  tracks: {{ .Values.tracking.tracks }}
  motion: {{ .Values.tracking.motion }}
  gateMetres: {{ .Values.tracking.gateMetres }}
  gapSeconds: {{ .Values.tracking.gapSeconds }}
{{- end }}
