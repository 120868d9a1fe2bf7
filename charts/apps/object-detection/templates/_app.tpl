{{- define "object-detection.app" -}}
image: object-detection
command: [robotkube-object-detection]
settings: watched
config:
  cloud: {{ .Values.detection.cloud }}
  objects: {{ .Values.detection.objects }}
  uncertainty: {{ .Values.detection.uncertainty }}
  method: {{ .Values.detection.method }}
  rangeMetres: {{ .Values.detection.rangeMetres }}
  pointsMin: {{ .Values.detection.pointsMin }}
{{- end }}
