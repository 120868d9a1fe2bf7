{{- /* Where the gate and its key stand. */ -}}
{{- define "robotkube.gateNamespace" -}}
{{ .Values.gate.namespace | default (printf "%s-gate" .Release.Namespace) }}
{{- end }}

{{- define "robotkube.gateKeySecret" -}}
{{ .Values.evidence.existingSecret | default "gate-key" }}
{{- end }}

{{- /* Given keys whose signatures count, a file each. */ -}}
{{- define "robotkube.evidenceKeys" -}}
{{- $keys := dict }}
{{- range $name, $pem := .Values.evidence.trustedKeys }}
{{- $_ := set $keys (printf "%s.pem" $name) (printf "%s\n" (trim $pem)) }}
{{- end }}
{{- toYaml $keys }}
{{- end }}

{{- /* All keys whose signatures count as a folder. The ConfigMap of the key that is made here comes from the Job gate-key: until it
       has run once, who reads it does not start. */ -}}
{{- define "robotkube.keysVolume" -}}
- name: keys
  projected:
    sources:
    - configMap: {name: evidence-keys}
    {{- if not .Values.evidence.existingSecret }}
    - configMap: {name: gate-public-key}
    {{- end }}
{{- end }}

{{- /* Processes read the keys when they start. */ -}}
{{- define "robotkube.keysAnnotation" -}}
robotkube.io/keys: {{ include "robotkube.evidenceKeys" . | sha256sum | trunc 16 | quote }}
{{- end }}

{{- /* What is wrong with the keys and the gate's place, one line each. */ -}}
{{- define "robotkube.evidenceRefusals" -}}
{{- $evidence := .Values.evidence }}
{{- $place := include "robotkube.gateNamespace" . }}
{{- if has $place (list .Release.Namespace .Values.argocd.namespace "default" "kube-system" "kube-public" "kube-node-lease") }}
{{ printf "gate.namespace: %q is used by others, and who may read Secrets there could sign. Leave it out, or give the gate a namespace of its own." $place }}
{{- end }}
{{- if gt (len $place) 63 }}
{{ printf "gate.namespace: %q has %d characters, a namespace at most 63. Give a shorter one." $place (len $place) }}
{{- end }}
{{- with $evidence.existingSecret }}
{{- if and (lookup "v1" "Secret" $.Release.Namespace .) (not (lookup "v1" "Secret" $place .)) }}
{{ printf "evidence.existingSecret: Secret %q stands in namespace %s, but the gate runs in %s now and mounts it there. Move it as UPGRADING.md says." . $.Release.Namespace $place }}
{{- end }}
{{- if not $evidence.trustedKeys }}
{{ printf "evidence.existingSecret is %q, but evidence.trustedKeys is empty: nobody would believe what that key signs. Put its public key there (openssl pkey -in key.pem -pubout)." . }}
{{- end }}
{{- end }}
{{- range $name, $pem := $evidence.trustedKeys }}
{{- if contains "PRIVATE KEY" $pem }}
{{ printf "evidence.trustedKeys.%s: is a private key; it would stand in a ConfigMap. Give the public one (openssl pkey -in key.pem -pubout), and use another key from now on." $name }}
{{- else if not (regexMatch "^\\s*-----BEGIN (PUBLIC KEY|CERTIFICATE)-----\\s" $pem) }}
{{ printf "evidence.trustedKeys.%s: must be PEM that begins with -----BEGIN PUBLIC KEY----- or -----BEGIN CERTIFICATE-----." $name }}
{{- end }}
{{- if and (regexMatch "^gate(-[0-9a-f]{16})?$" $name) (not $evidence.existingSecret) }}
{{ printf "evidence.trustedKeys.%s: this name belongs to the key that is made here. Use another name, or give that key's Secret in evidence.existingSecret." $name }}
{{- end }}
{{- end }}
{{- end }}
