{{- /* The gate's key pair when the chart makes it, as {key, certificate}: kept from before, else new. Set once per rendering, so that
       all templates see the same. The certificate carries the public key; its dates and names are not read. */ -}}
{{- define "robotkube.gateKeyPair" -}}
{{- if not (hasKey .Values.evidence "pair") }}
{{- $kept := lookup "v1" "Secret" .Release.Namespace "gate-key" | dig "data" (dict) }}
{{- $key := get $kept "key.pem" | b64dec | default (genPrivateKey "ed25519") }}
{{- $certificate := get $kept "certificate.pem" | b64dec }}
{{- if not $certificate }}
{{- $certificate = (genSelfSignedCertWithKey "robotkube-gate" nil nil 36500 $key).Cert }}
{{- end }}
{{- $_ := set .Values.evidence "pair" (dict "key" $key "certificate" $certificate) }}
{{- end }}
{{- toYaml .Values.evidence.pair }}
{{- end }}

{{- define "robotkube.gateKeySecret" -}}
{{ .Values.evidence.existingSecret | default "gate-key" }}
{{- end }}

{{- /* Keys whose signatures count, a file each. */ -}}
{{- define "robotkube.evidenceKeys" -}}
{{- $keys := dict }}
{{- if not .Values.evidence.existingSecret }}
{{- $_ := set $keys "gate.pem" (include "robotkube.gateKeyPair" . | fromYaml).certificate }}
{{- end }}
{{- range $name, $pem := .Values.evidence.trustedKeys }}
{{- $_ := set $keys (printf "%s.pem" $name) (printf "%s\n" (trim $pem)) }}
{{- end }}
{{- toYaml $keys }}
{{- end }}

{{- /* Processes read the keys when they start. */ -}}
{{- define "robotkube.keysAnnotation" -}}
robotkube.io/keys: {{ include "robotkube.evidenceKeys" . | sha256sum | trunc 16 | quote }}
{{- end }}
