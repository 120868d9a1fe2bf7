{{- define "__NAME__.app" -}}
image: ros
command: [python3, /etc/robotkube/node.py]
settings: watched
serviceAccount: application
files:
  node.py: {{ .Files.Get "files/node.py" | toJson }}
  answers.py: {{ .Files.Get "files/answers.py" | toJson }}
config:
  input: {{ .Values.relay.input }}
  output: {{ .Values.relay.output }}
{{- end }}
