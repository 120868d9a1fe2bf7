{{- /* TLS: who makes the broker's certificate, and how everybody else knows it. */ -}}
{{- /* The values of tls, also when an upgrade reuses values from before there were any. YAML. */ -}}
{{- define "robotkube.tls" -}}
{{- $tls := dict "mode" "made" "plain" false "hours" 2160 "names" list "authorities" "" "provided" (dict "secret" "") }}
{{- $_ := set $tls "issuer" (dict "name" "" "kind" "Issuer" "group" "cert-manager.io") }}
{{- range $key, $value := .Values.tls | default dict }}
{{- if kindIs "map" $value }}{{ $value = merge (deepCopy $value) (get $tls $key) }}{{ end }}
{{- $_ := set $tls $key $value }}
{{- end }}
{{- toYaml $tls }}
{{- end }}

{{- /* "true" when connections to the broker are encrypted, else empty. */ -}}
{{- define "robotkube.encrypted" -}}
{{- if ne (include "robotkube.tls" . | fromYaml).mode "off" }}true{{ end -}}
{{- end }}

{{- /* "true" when the broker that is installed here takes connections in clear text, else empty. */ -}}
{{- define "robotkube.plain" -}}
{{- $tls := include "robotkube.tls" . | fromYaml -}}
{{- if and (eq .Values.broker.kind "mosquitto") (or $tls.plain (eq $tls.mode "off")) }}true{{ end -}}
{{- end }}

{{- /* "true" when certificates are made here, by the process `certificates`, else empty. */ -}}
{{- define "robotkube.certificatesMade" -}}
{{- if and (eq .Values.broker.kind "mosquitto") (eq (include "robotkube.tls" . | fromYaml).mode "made") }}true{{ end -}}
{{- end }}

{{- /* The Secret with the broker's certificate and key. */ -}}
{{- define "robotkube.brokerCertificate" -}}
{{- $tls := include "robotkube.tls" . | fromYaml -}}
{{ eq $tls.mode "provided" | ternary $tls.provided.secret "broker-tls" }}
{{- end }}

{{- /* The names that the broker's certificate is for: its Service's, and those by which clients elsewhere reach it. JSON. */ -}}
{{- define "robotkube.brokerNames" -}}
{{- $short := printf "broker.%s" .Release.Namespace -}}
{{- $names := list (include "robotkube.brokerHost" .) (printf "%s.svc" $short) $short "broker" -}}
{{ concat $names (include "robotkube.tls" . | fromYaml).names | uniq | toJson }}
{{- end }}

{{- /* How the broker is reached and proves who it is, as keys of the Secrets with accounts. */ -}}
{{- define "robotkube.brokerEndpoint" -}}
host: {{ include "robotkube.brokerHost" . }}
port: {{ include "robotkube.brokerPort" . | quote }}
tls: {{ include "robotkube.encrypted" . | eq "true" | ternary "required" "off" | quote }}
{{- end }}

{{- /* The same in the settings of a process of the platform. */ -}}
{{- define "robotkube.brokerSettings" -}}
host: {{ include "robotkube.brokerHost" . }}
port: {{ include "robotkube.brokerPort" . }}
credentials: /var/run/secrets/robotkube/broker
{{- if include "robotkube.encrypted" . }}
authorities: /etc/robotkube/authorities/ca.crt
{{- end }}
{{- end }}

{{- /* Volume and mount of those who may have signed the broker's certificate: a pod waits until they are known. */ -}}
{{- define "robotkube.authoritiesVolume" -}}
{{- if include "robotkube.encrypted" . -}}
- {name: authorities, configMap: {name: robotkube-ca, items: [{key: ca.crt, path: ca.crt}]}}
{{- end }}
{{- end }}

{{- define "robotkube.authoritiesMount" -}}
{{- if include "robotkube.encrypted" . -}}
- {name: authorities, mountPath: /etc/robotkube/authorities, readOnly: true}
{{- end }}
{{- end }}

{{- /* The namespaces in which somebody connects to the broker. JSON. */ -}}
{{- define "robotkube.connecting" -}}
{{- $namespaces := list .Release.Namespace }}
{{- range .Values.agents }}{{ $namespaces = append $namespaces .name }}{{ end -}}
{{ toJson $namespaces }}
{{- end }}

{{- /* Runs mosquitto, and has it read certificate and key again when the kubelet has brought new ones. A shell's child, so the pod needs
       neither another container nor one that sees the processes of this one. */ -}}
{{- define "robotkube.brokerProgram" -}}
read=/run/mosquitto/certificate-read
: > "$read"
(
  while sleep 5 && kill -0 $$; do
    if [ /etc/mosquitto-tls/tls.crt -nt "$read" ]; then
      : > "$read"
      kill -HUP $$
    fi
  done
) &
exec mosquitto -c /etc/mosquitto/mosquitto.conf
{{- end }}

{{- /* The values of the process `certificates`, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.certificates" -}}
{{- $defaults := dict "resources" (dict "requests" (dict "cpu" "10m" "memory" "48Mi") "limits" (dict "memory" "128Mi")) }}
{{- range $key, $value := .Values.certificates | default dict }}{{ $_ := set $defaults $key $value }}{{ end }}
{{- toYaml $defaults }}
{{- end }}

{{- define "robotkube.certificatesSettings" -}}
{{- $tls := include "robotkube.tls" . | fromYaml -}}
listen: {address: 0.0.0.0, port: 8081}
log_level: {{ .Values.logLevel }}
namespace: {{ .Release.Namespace }}
authority: {secret: tls-authority}
certificate: {secret: broker-tls, names: {{ include "robotkube.brokerNames" . }}, life_seconds: {{ mul (int $tls.hours) 3600 }}}
trusted: {config_map: robotkube-ca, namespaces: {{ include "robotkube.connecting" . }}}
{{- end }}

{{- /* What is wrong with tls, one line each. */ -}}
{{- define "robotkube.tlsRefusals" -}}
{{- $tls := include "robotkube.tls" . | fromYaml }}
{{- $external := eq .Values.broker.kind "external" }}
{{- if and $external (has $tls.mode (list "made" "cert-manager")) }}
{{ printf "tls.mode is %s, but broker.kind is external: its owner has its certificate. Set tls.mode: provided with the PEM of its authority in tls.authorities, or tls.mode: \"off\" if it takes connections in clear text." $tls.mode }}
{{- end }}
{{- if and (has $tls.mode (list "provided" "cert-manager")) (not $tls.authorities) }}
{{ printf "tls.mode is %s, but tls.authorities is empty: nobody could verify the broker. Put the PEM of the authority's certificate there, which is public." $tls.mode }}
{{- end }}
{{- if contains "PRIVATE KEY" $tls.authorities }}
{{ print "tls.authorities: holds a private key; it would stand in ConfigMaps that every agent reads. Give the certificate alone, and use another authority from now on." }}
{{- else if and $tls.authorities (not (regexMatch "^\\s*-----BEGIN CERTIFICATE-----\\s" $tls.authorities)) }}
{{ print "tls.authorities: must be PEM that begins with -----BEGIN CERTIFICATE-----; several certificates stand one after the other." }}
{{- end }}
{{- if and $tls.authorities (has $tls.mode (list "made" "off")) }}
{{ printf "tls.authorities is given, but tls.mode is %s: nobody would trust them. Set the mode to provided or cert-manager, or leave them out." $tls.mode }}
{{- end }}
{{- if and (eq $tls.mode "provided") (not $external) (not $tls.provided.secret) }}
{{ print "tls.mode is provided, but tls.provided.secret is empty. Name the Secret in the platform's namespace that has the broker's tls.crt and tls.key." }}
{{- end }}
{{- if and (ne $tls.mode "provided") $tls.provided.secret }}
{{ printf "tls.provided.secret is given, but tls.mode is %s. Set the mode to provided, or leave the Secret out." $tls.mode }}
{{- end }}
{{- if and (eq $tls.mode "cert-manager") (not $tls.issuer.name) }}
{{ print "tls.mode is cert-manager, but tls.issuer.name is empty. Name the Issuer that signs the broker's certificate." }}
{{- end }}
{{- if and (ne $tls.mode "cert-manager") $tls.issuer.name }}
{{ printf "tls.issuer.name is given, but tls.mode is %s. Set the mode to cert-manager, or leave the name out." $tls.mode }}
{{- end }}
{{- if and $external $tls.plain }}
{{ print "tls.plain is true, but broker.kind is external: its listeners are its owner's. Leave it out; tls.mode: \"off\" connects in clear text." }}
{{- end }}
{{- end }}
