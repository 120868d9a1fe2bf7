{{- /* The one random value. Given; or kept from before; or new. Set once per rendering, so that all templates see the same. */ -}}
{{- define "robotkube.seed" -}}
{{- if not .Values.secrets.seed }}
{{- $kept := lookup "v1" "Secret" .Release.Namespace "robotkube-seed" }}
{{- $_ := set .Values.secrets "seed" ($kept | empty | ternary (randAlphaNum 64) (dig "data" "seed" "" $kept | b64dec)) }}
{{- end }}
{{- .Values.secrets.seed -}}
{{- end }}

{{- /* 240 bits that follow from the seed and nothing else: the same on every upgrade, and of no use for guessing another account's.
       Argument: {root, purpose, account}. */ -}}
{{- define "robotkube.password" -}}
{{ printf "%s/%s/%s" (include "robotkube.seed" .root) .purpose .account | sha256sum | trunc 60 }}
{{- end }}
