{{- define "object-detection.app" -}}
image: ros
command: [python3, -m, robotkube.entrypoints.object_detection]
config:
  cloud: {{ .Values.detection.cloud }}
  objects: {{ .Values.detection.objects }}
  uncertainty: {{ .Values.detection.uncertainty }}
  method: {{ .Values.detection.method }}
  rangeMetres: {{ .Values.detection.rangeMetres }}
  pointsMin: {{ .Values.detection.pointsMin }}
{{- end }}
