{{- define "object-detection.app" -}}
image: ros
command: [robotkube-object-detection]
config:
  cloud: {{ .Values.detection.cloud }}
  objects: {{ .Values.detection.objects }}
  uncertainty: {{ .Values.detection.uncertainty }}
  method: {{ .Values.detection.method }}
  rangeMetres: {{ .Values.detection.rangeMetres }}
  pointsMin: {{ .Values.detection.pointsMin }}
{{- end }}
