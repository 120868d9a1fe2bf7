{{- /* Addresses of all pods of a namespace, ready or not: processes of ROS 2 send each other what they announce. Arguments: root, namespace, labels, selector. */ -}}
{{- define "robotkube.peers" -}}
---
apiVersion: v1
kind: Service
metadata:
  name: ros-peers
  namespace: {{ .namespace }}
  labels: {{- .labels | nindent 4 }}
spec:
  clusterIP: None
  publishNotReadyAddresses: true
  selector: {{ toJson .selector }}
  ports: [{name: discovery, protocol: UDP, port: 7410}]
{{ end }}
