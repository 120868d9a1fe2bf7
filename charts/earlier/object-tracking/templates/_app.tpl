{{- define "object-tracking.app" -}}
image: ros
command: [robotkube-object-tracking]
config:
  objects: {{ .Values.tracking.objects }}
  tracks: {{ .Values.tracking.tracks }}
  motion: still
  gateMetres: {{ .Values.tracking.gateMetres }}
  gapSeconds: {{ .Values.tracking.gapSeconds }}
{{- end }}
