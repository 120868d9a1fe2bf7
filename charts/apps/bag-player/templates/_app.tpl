{{- define "bag-player.app" -}}
image: bag-player
command: [robotkube-player]
settings: restart
serviceAccount: bag-player
claims: [{name: bags, claim: {{ .Values.bags.claim | quote }}, path: /var/lib/robotkube/bags}]
config:
  agent: {{ .Values.player.agent | default .Values.placement.agent | quote }}
  bag: {{ .Values.player.bag | default (printf "/var/lib/robotkube/bags/%s" .Values.placement.agent) }}
  ledger: {{ .Values.player.ledger }}
{{- end }}
