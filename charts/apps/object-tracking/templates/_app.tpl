{{- define "object-tracking.app" -}}
image: ros
command: [robotkube-object-tracking]
config:
  objects: {{ .Values.tracking.objects }}
  tracks: {{ .Values.tracking.tracks }}
  motion: {{ .Values.tracking.motion }}
  gateMetres: {{ .Values.tracking.gateMetres }}
  gapSeconds: {{ .Values.tracking.gapSeconds }}
{{- end }}
