{{- /* TLS: who makes the certificates of broker, database, forge and processes, and how everybody else knows them. */ -}}
{{- /* The values of tls, also when an upgrade reuses values from before there were any. JSON. */ -}}
{{- define "robotkube.tls" -}}
{{- include "robotkube.once" (dict "root" . "of" "robotkube.tlsOfValues") -}}
{{- end }}

{{- define "robotkube.tlsOfValues" -}}
{{- $tls := dict "mode" "made" "plain" false "processes" false "accounts" "passwords" "hours" 2160 "names" list "authorities" "" "provided" (dict "secret" "" "database" "" "forge" "" "processes" dict) }}
{{- $_ := set $tls "issuer" (dict "name" "" "kind" "Issuer" "group" "cert-manager.io") }}
{{- range $key, $value := .Values.tls | default dict }}
{{- if kindIs "map" $value }}{{ $value = merge (deepCopy $value) (get $tls $key) }}{{ end }}
{{- $_ := set $tls $key $value }}
{{- end }}
{{- toJson $tls }}
{{- end }}

{{- /* "true" when connections to the broker are encrypted, else empty. */ -}}
{{- define "robotkube.encrypted" -}}
{{- if ne (include "robotkube.tls" . | fromJson).mode "off" }}true{{ end -}}
{{- end }}

{{- /* "true" when the broker that is installed here takes connections in clear text, else empty. */ -}}
{{- define "robotkube.plain" -}}
{{- $tls := include "robotkube.tls" . | fromJson -}}
{{- if and (eq .Values.broker.kind "mosquitto") (or $tls.plain (eq $tls.mode "off")) }}true{{ end -}}
{{- end }}

{{- /* "true" when connections to the database are encrypted, else empty. */ -}}
{{- define "robotkube.databaseEncrypted" -}}
{{- if eq .Values.database.kind "external" }}
{{- if .Values.database.external.tls }}true{{ end }}
{{- else }}
{{- include "robotkube.encrypted" . }}
{{- end }}
{{- end }}

{{- /* "true" when the database that is installed here takes connections in clear text, else empty. */ -}}
{{- define "robotkube.databasePlain" -}}
{{- $tls := include "robotkube.tls" . | fromJson -}}
{{- if and (ne .Values.database.kind "external") (or $tls.plain (eq $tls.mode "off")) }}true{{ end -}}
{{- end }}

{{- /* "true" when the forge that is installed here speaks TLS, else empty. */ -}}
{{- define "robotkube.forgeEncrypted" -}}
{{- if and (eq .Values.forge.kind "gitea") (eq (toString .Values.forge.tls) "true") }}{{ include "robotkube.encrypted" . }}{{ end -}}
{{- end }}

{{- /* "true" when gate, managers, rights, admission and suite-runner speak HTTPS, else empty. */ -}}
{{- define "robotkube.processesEncrypted" -}}
{{- if (include "robotkube.tls" . | fromJson).processes }}{{ include "robotkube.encrypted" . }}{{ end -}}
{{- end }}

{{- /* How they are asked. */ -}}
{{- define "robotkube.processScheme" -}}
{{ include "robotkube.processesEncrypted" . | eq "true" | ternary "https" "http" }}
{{- end }}

{{- /* Those that are installed, as a list of {name, namespace}, each by the name of its Service. JSON. */ -}}
{{- define "robotkube.servingProcesses" -}}
{{- $found := list (dict "name" "gate" "namespace" (include "robotkube.gateNamespace" .)) }}
{{- range $name := concat (splitList " " (include "robotkube.managerNames" .)) ((include "robotkube.rights" . | fromJson).enabled | ternary (list "rights") list) (.Values.admission.enabled | ternary (list "admission") list) (.Values.suites.enabled | ternary (list "suite-runner") list) }}
{{- $found = append $found (dict "name" $name "namespace" $.Release.Namespace) }}
{{- end }}
{{- toJson $found }}
{{- end }}

{{- /* The Secret with the certificate and key of one. Arguments: {root, name}. */ -}}
{{- define "robotkube.processCertificate" -}}
{{- $tls := include "robotkube.tls" .root | fromJson -}}
{{ eq $tls.mode "provided" | ternary (get $tls.provided.processes .name) (printf "%s-tls" .name) }}
{{- end }}

{{- /* The same among the files of its pod, which so waits until there is a certificate. Arguments: as above. */ -}}
{{- define "robotkube.certificateFiles" -}}
{{- if include "robotkube.processesEncrypted" .root -}}
- secret: {name: {{ include "robotkube.processCertificate" . }}, items: [{key: tls.crt, path: certificate/tls.crt}, {key: tls.key, path: certificate/tls.key}]}
{{- end }}
{{- end }}

{{- /* Where such a process listens, in its settings. */ -}}
{{- define "robotkube.listen" -}}
listen: {address: 0.0.0.0, port: 8080, health_port: 8081{{ if include "robotkube.processesEncrypted" . }}, certificate: /var/run/secrets/robotkube/certificate{{ end }}}
{{- end }}

{{- /* Who may have signed the certificates of such processes, in the settings of one that asks them. */ -}}
{{- define "robotkube.processAuthorities" -}}
{{- if include "robotkube.processesEncrypted" . -}}
authorities: /etc/robotkube/authorities/ca.crt
{{- end }}
{{- end }}

{{- /* "true" when certificates are made here, by the process `certificates`, else empty. */ -}}
{{- define "robotkube.certificatesMade" -}}
{{- if and (eq .Values.broker.kind "mosquitto") (eq (include "robotkube.tls" . | fromJson).mode "made") }}true{{ end -}}
{{- end }}

{{- /* "true" when accounts at the broker are proved by certificates, else empty. Left to itself a platform goes on as it was: robots whose
       images are of before know nothing of certificates, and the broker takes one or the other. */ -}}
{{- define "robotkube.accountsCertified" -}}
{{- $tls := include "robotkube.tls" . | fromJson }}
{{- $left := and (eq $tls.accounts "auto") (not $tls.plain) }}
{{- if or (eq $tls.accounts "certificates") (and $left (not (include "robotkube.accountsOfBefore" .))) }}{{ include "robotkube.certificatesMade" . }}{{ end -}}
{{- end }}

{{- /* "true" when this platform is there already, with accounts that are proved by passwords, else empty. */ -}}
{{- define "robotkube.accountsOfBefore" -}}
{{- include "robotkube.once" (dict "root" . "of" "robotkube.accountsFound") -}}
{{- end }}

{{- define "robotkube.accountsFound" -}}
{{- with lookup "v1" "Secret" .Release.Namespace "broker-account-observer" }}{{ if ne (get .data "identity") ("certificate" | b64enc) }}true{{ end }}{{ end -}}
{{- end }}

{{- /* These accounts, as a list of {account, secret, namespace} with number and reserved where they have any. JSON. */ -}}
{{- define "robotkube.certifiedAccounts" -}}
{{- $found := list }}
{{- range concat (list "observer") ((include "robotkube.rights" . | fromJson).enabled | ternary (list "rights") list) (splitList " " (include "robotkube.managerNames" .)) }}
{{- $found = append $found (dict "account" . "secret" (printf "broker-account-%s" .) "namespace" $.Release.Namespace) }}
{{- end }}
{{- range .Values.agents }}
{{- $account := dict "account" .name "secret" "broker-account" "namespace" .name }}
{{- with .brokerPasswordNumber }}{{ $_ := set $account "number" (int .) }}{{ end }}
{{- if .reserved }}{{ $_ := set $account "reserved" true }}{{ end }}
{{- $found = append $found $account }}
{{- end }}
{{- toJson $found }}
{{- end }}

{{- /* An account at the broker among the files of a process of the platform; with a certificate its pod waits until there is one.
       Arguments: {root, secret}. */ -}}
{{- define "robotkube.brokerCredentials" -}}
{{- $items := list "username" "password" }}
{{- if include "robotkube.accountsCertified" .root }}{{ $items = concat $items (list "identity" "tls.crt" "tls.key") }}{{ end -}}
- secret:
    name: {{ .secret }}
    items:
    {{- range $items }}
    - {key: {{ . }}, path: broker/{{ . }}}
    {{- end }}
{{- end }}

{{- /* The Secret with the broker's certificate and key. */ -}}
{{- define "robotkube.brokerCertificate" -}}
{{- $tls := include "robotkube.tls" . | fromJson -}}
{{ eq $tls.mode "provided" | ternary $tls.provided.secret "broker-tls" }}
{{- end }}

{{- /* The Secret with the database's certificate and key. */ -}}
{{- define "robotkube.databaseCertificate" -}}
{{- $tls := include "robotkube.tls" . | fromJson -}}
{{ eq $tls.mode "provided" | ternary $tls.provided.database "database-tls" }}
{{- end }}

{{- /* The Secret with the forge's certificate and key. */ -}}
{{- define "robotkube.forgeCertificate" -}}
{{- $tls := include "robotkube.tls" . | fromJson -}}
{{ eq $tls.mode "provided" | ternary $tls.provided.forge "forge-tls" }}
{{- end }}

{{- /* What has a certificate of its own here, as {component: names}: those of its Service, and for broker and forge those by which
       clients elsewhere reach them; for the forge also those of its own pod, at which its hooks and whoever forwards a port ask. JSON. */ -}}
{{- define "robotkube.certified" -}}
{{- $certified := dict "broker" (concat (include "robotkube.serviceNames" (dict "root" . "name" "broker") | fromJsonArray) (include "robotkube.tls" . | fromJson).names | uniq) }}
{{- if include "robotkube.processesEncrypted" . }}
{{- range include "robotkube.servingProcesses" . | fromJsonArray }}
{{- $_ := set $certified .name (include "robotkube.serviceNames" (dict "root" $ "name" .name "namespace" .namespace) | fromJsonArray) }}
{{- end }}
{{- end }}
{{- if ne .Values.database.kind "external" }}
{{- $_ := set $certified "database" (include "robotkube.serviceNames" (dict "root" . "name" "database") | fromJsonArray) }}
{{- end }}
{{- if include "robotkube.forgeEncrypted" . }}
{{- $_ := set $certified "forge" (concat (include "robotkube.serviceNames" (dict "root" . "name" "forge") | fromJsonArray) (list "localhost" "127.0.0.1") (.Values.forge.names | default list) | uniq) }}
{{- end }}
{{- toJson $certified }}
{{- end }}

{{- /* The namespace of one of them: that of the pod that mounts its Secret. Arguments: {root, component}. */ -}}
{{- define "robotkube.certifiedNamespace" -}}
{{ eq .component "gate" | ternary (include "robotkube.gateNamespace" .root) .root.Release.Namespace }}
{{- end }}

{{- /* The names of a Service, the longest first. Arguments: {root, name} and, optional, namespace. JSON. */ -}}
{{- define "robotkube.serviceNames" -}}
{{- $short := printf "%s.%s" .name (.namespace | default .root.Release.Namespace) -}}
{{ list (include "robotkube.host" .) (printf "%s.svc" $short) $short .name | toJson }}
{{- end }}

{{- /* How the broker is reached and proves who it is, as keys of the Secrets with accounts. */ -}}
{{- define "robotkube.brokerEndpoint" -}}
host: {{ include "robotkube.brokerHost" . }}
port: {{ include "robotkube.brokerPort" . | quote }}
tls: {{ include "robotkube.encrypted" . | eq "true" | ternary "required" "off" | quote }}
identity: {{ include "robotkube.accountsCertified" . | eq "true" | ternary "certificate" "password" }}
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

{{- /* Who may have signed the forge's certificate, in the settings of a process that asks the forge. */ -}}
{{- define "robotkube.forgeAuthorities" -}}
{{- if include "robotkube.forgeEncrypted" . -}}
authorities: /etc/robotkube/authorities/ca.crt
{{- end }}
{{- end }}

{{- /* Volume and mount of those who may have signed certificates: a pod waits until they are known. */ -}}
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

{{- /* The same where the forge and processes are asked. */ -}}
{{- define "robotkube.httpAuthoritiesVolume" -}}
{{- if or (include "robotkube.forgeEncrypted" .) (include "robotkube.processesEncrypted" .) }}{{ include "robotkube.authoritiesVolume" . }}{{ end }}
{{- end }}

{{- define "robotkube.httpAuthoritiesMount" -}}
{{- if or (include "robotkube.forgeEncrypted" .) (include "robotkube.processesEncrypted" .) }}{{ include "robotkube.authoritiesMount" . }}{{ end }}
{{- end }}

{{- /* The same where the forge alone is asked. */ -}}
{{- define "robotkube.forgeAuthoritiesVolume" -}}
{{- if include "robotkube.forgeEncrypted" . }}{{ include "robotkube.authoritiesVolume" . }}{{ end }}
{{- end }}

{{- define "robotkube.forgeAuthoritiesMount" -}}
{{- if include "robotkube.forgeEncrypted" . }}{{ include "robotkube.authoritiesMount" . }}{{ end }}
{{- end }}

{{- /* The namespaces in which somebody connects to broker, database, forge or a process. JSON. */ -}}
{{- define "robotkube.connecting" -}}
{{- $namespaces := list .Release.Namespace }}
{{- if or (include "robotkube.forgeEncrypted" .) (include "robotkube.processesEncrypted" .) }}{{ $namespaces = append $namespaces (include "robotkube.gateNamespace" .) }}{{ end }}
{{- range .Values.agents }}{{ $namespaces = append $namespaces .name }}{{ end -}}
{{ toJson $namespaces }}
{{- end }}

{{- /* Signals the program that will follow in the same shell when the kubelet has brought another certificate. A shell's child, so the
       pod needs neither another container nor one that sees the processes of this one. `also`: a further file that is looked at.
       Arguments: {folder, run, signal, also}. */ -}}
{{- define "robotkube.certificateWatch" -}}
read={{ .run }}/certificate-read
: > "$read"
(
  while sleep 5 && kill -0 $$; do
    if [ {{ .folder }}/tls.crt -nt "$read" ]{{ with .also }} || [ {{ . }} -nt "$read" ]{{ end }}; then
      : > "$read"
      kill -{{ .signal }} $$
    fi
  done
) &
{{- end }}

{{- /* Runs mosquitto, which reads certificate and key again on SIGHUP, and the list of revoked ones. */ -}}
{{- define "robotkube.brokerProgram" -}}
{{- $revoked := include "robotkube.accountsCertified" . | eq "true" | ternary "/etc/mosquitto-accounts/revoked.crl" "" -}}
{{ include "robotkube.certificateWatch" (dict "folder" "/etc/mosquitto-tls" "run" "/run/mosquitto" "signal" "HUP" "also" $revoked) }}
exec mosquitto -c /etc/mosquitto/mosquitto.conf
{{- end }}

{{- /* Runs mongod, which reads certificate and key, in one file, at its start alone: a renewed one ends it, and the kubelet starts it again. */ -}}
{{- define "robotkube.databaseProgram" -}}
{{- $folder := "/etc/database-tls" -}}
{{ include "robotkube.certificateWatch" (dict "folder" $folder "run" "/run/database" "signal" "TERM") }}
umask 077
cat {{ $folder }}/tls.crt {{ $folder }}/tls.key > /run/database/tls.pem
exec docker-entrypoint.sh mongod "$@"
{{- end }}

{{- /* Runs the forge. It reads certificate, key and whom to believe at its start alone, but on SIGHUP it starts a second process that takes over the open
       port, and ends when it has answered what it was asked. A connection that it accepts as its last it ends unread: who made that asks
       again. So this shell stays, and knows the one that serves by its file; when there is none a second time, the forge has ended. */ -}}
{{- define "robotkube.forgeProgram" -}}
{{- $run := "/run/forge" -}}
serving() { kill "-$1" "$(cat {{ $run }}/pid)" 2> /dev/null; }
rest() { sleep "$1" & wait $! || :; }
changed() { [ /etc/forge-tls/tls.crt -nt "$read" ] || [ /etc/robotkube/authorities/ca.crt -nt "$read" ]; }
pause=5
trap 'pause=1; serving TERM' TERM
read={{ $run }}/certificate-read
: > "$read"
gitea --config /etc/gitea/app.ini web --pid {{ $run }}/pid &
echo $! > {{ $run }}/pid
missed=0
while [ $missed -lt 2 ]; do
  rest $pause
  if serving 0; then missed=0; else missed=$((missed + 1)); continue; fi
  if changed; then
    : > "$read"
    former=$(cat {{ $run }}/pid) waited=0
    serving HUP
    while [ "$(cat {{ $run }}/pid)" = "$former" ] && [ $waited -lt 60 ]; do
      rest 1
      waited=$((waited + 1))
    done
  fi
done
{{- end }}

{{- /* Where and how the database listens, as arguments of its command. FerretDB reads a renewed certificate by itself. JSON. */ -}}
{{- define "robotkube.databaseListeners" -}}
{{- $encrypted := include "robotkube.databaseEncrypted" . }}
{{- $plain := include "robotkube.databasePlain" . }}
{{- $arguments := list }}
{{- if eq .Values.database.kind "ferretdb" }}
{{- $arguments = append $arguments (printf "--listen-addr=%s" ($plain | eq "true" | ternary ":27017" "")) }}
{{- if $encrypted }}
{{- $arguments = concat $arguments (list "--listen-tls=:27018" "--listen-tls-cert-file=/etc/database-tls/tls.crt" "--listen-tls-key-file=/etc/database-tls/tls.key") }}
{{- end }}
{{- else if $encrypted }}
{{- $mode := $plain | eq "true" | ternary "preferTLS" "requireTLS" }}
{{- $arguments = list "--port=27018" (printf "--tlsMode=%s" $mode) "--tlsCertificateKeyFile=/run/database/tls.pem" "--tlsCAFile=/etc/robotkube/authorities/ca.crt" "--tlsAllowConnectionsWithoutCertificates" }}
{{- end }}
{{- toJson $arguments }}
{{- end }}

{{- /* The values of the process `certificates`, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.certificates" -}}
{{- $defaults := dict "resources" (dict "requests" (dict "cpu" "10m" "memory" "48Mi") "limits" (dict "memory" "128Mi")) }}
{{- range $key, $value := .Values.certificates | default dict }}{{ $_ := set $defaults $key $value }}{{ end }}
{{- toJson $defaults }}
{{- end }}

{{- define "robotkube.certificatesSettings" -}}
{{- $tls := include "robotkube.tls" . | fromJson -}}
listen: {address: 0.0.0.0, port: 8081}
log_level: {{ .Values.logLevel }}
namespace: {{ .Release.Namespace }}
authority: {secret: tls-authority}
certificates:
{{- range $component, $names := include "robotkube.certified" . | fromJson }}
{{- $namespace := include "robotkube.certifiedNamespace" (dict "root" $ "component" $component) }}
- {secret: {{ $component }}-tls, names: {{ toJson $names }}, life_seconds: {{ mul (int $tls.hours) 3600 }}{{ if eq $component "forge" }}, service: forge{{ end }}{{ if ne $namespace $.Release.Namespace }}, namespace: {{ $namespace }}{{ end }}}
{{- end }}
trusted: {config_map: robotkube-ca, namespaces: {{ include "robotkube.connecting" . }}}
{{- if include "robotkube.accountsCertified" . }}
accounts:
  register: broker-certificates
  shut: {{ include "robotkube.processScheme" . }}://{{ include "robotkube.host" (dict "root" . "name" "rights") }}:8080/accounts
  life_seconds: {{ mul (int $tls.hours) 3600 }}
  of:
  {{- range include "robotkube.certifiedAccounts" . | fromJsonArray }}
  - {{ toJson . }}
  {{- end }}
{{- end }}
{{- end }}

{{- /* What is wrong with tls, one line each. */ -}}
{{- define "robotkube.tlsRefusals" -}}
{{- $tls := include "robotkube.tls" . | fromJson }}
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
{{- if and (eq $tls.mode "provided") (ne .Values.database.kind "external") (not $tls.provided.database) }}
{{ printf "tls.mode is provided, but tls.provided.database is empty. Name the Secret in the platform's namespace that has the database's tls.crt and tls.key, for the name %s; it may be tls.provided.secret, if that certificate is for this name too." (include "robotkube.databaseHost" .) }}
{{- end }}
{{- if and (eq $tls.mode "provided") (include "robotkube.forgeEncrypted" .) (not $tls.provided.forge) }}
{{ printf "tls.mode is provided, but tls.provided.forge is empty. Name the Secret in the platform's namespace that has the forge's tls.crt and tls.key, for the names %s, localhost and 127.0.0.1; or set forge.tls: false, and it speaks HTTP." (regexReplaceAll ":[0-9]+$" (include "robotkube.forgeHost" .) "") }}
{{- end }}
{{- if and $tls.provided.forge (or (ne $tls.mode "provided") (not (include "robotkube.forgeEncrypted" .))) }}
{{ printf "tls.provided.forge is given, but tls.mode is %s, forge.kind %s and forge.tls %v: nobody mounts it. Leave it out, or set tls.mode: provided and forge.tls: true." $tls.mode .Values.forge.kind .Values.forge.tls }}
{{- end }}
{{- if and (eq $tls.accounts "certificates") (or $external (ne $tls.mode "made")) }}
{{ printf "tls.accounts is certificates, but tls.mode is %s and broker.kind %s: accounts' certificates are made by the process `certificates` alone. Set tls.accounts: auto, or tls.mode: made with broker.kind: mosquitto." $tls.mode .Values.broker.kind }}
{{- end }}
{{- if and (eq $tls.accounts "certificates") $tls.plain }}
{{ print "tls.accounts is certificates, but tls.plain is true: who has a password would connect at 1883 without a certificate. Set tls.accounts: auto, or leave tls.plain out." }}
{{- end }}
{{- $processes := include "robotkube.processesEncrypted" . }}
{{- $serving := list }}{{ range include "robotkube.servingProcesses" . | fromJsonArray }}{{ $serving = append $serving .name }}{{ end }}
{{- if and $processes (eq $tls.mode "provided") }}
{{- range include "robotkube.servingProcesses" . | fromJsonArray }}{{ if not (get $tls.provided.processes .name) }}
{{ printf "tls.processes is true, but tls.provided.processes names no Secret for %s. Name the one in namespace %s that has its tls.crt and tls.key, for the name %s; or set tls.processes: false, and all speak HTTP." .name .namespace (include "robotkube.host" (dict "root" $ "name" .name "namespace" .namespace)) }}
{{- end }}{{ end }}
{{- end }}
{{- range $name, $_ := $tls.provided.processes }}
{{- if or (not $processes) (ne $tls.mode "provided") }}
{{ printf "tls.provided.processes names a Secret for %s, but tls.mode is %s and tls.processes %v: nobody mounts it. Leave it out, or set tls.mode: provided and tls.processes: true." $name $tls.mode $tls.processes }}
{{- else if not (has $name $serving) }}
{{ printf "tls.provided.processes names a Secret for %s, which is no process that serves here. Name some of %s." $name (join ", " $serving) }}
{{- end }}
{{- end }}
{{- if and $processes (eq $tls.mode "cert-manager") (eq $tls.issuer.kind "Issuer") (eq $tls.issuer.group "cert-manager.io") }}
{{ printf "tls.processes is true, but tls.issuer.kind is Issuer, which signs in the platform's namespace alone, and the gate stands in %s. Name a ClusterIssuer, or set tls.processes: false." (include "robotkube.gateNamespace" .) }}
{{- end }}
{{- if and .Values.forge.names (not (include "robotkube.forgeEncrypted" .)) }}
{{ print "forge.names is given, but the forge has no certificate here: tls.mode is \"off\", forge.tls false or forge.kind external. Leave it out." }}
{{- end }}
{{- if and $tls.provided.database (or (ne $tls.mode "provided") (eq .Values.database.kind "external")) }}
{{ printf "tls.provided.database is given, but tls.mode is %s and database.kind %s: nobody mounts it. Leave it out, or set the mode to provided." $tls.mode .Values.database.kind }}
{{- end }}
{{- if and .Values.database.external.tls (ne .Values.database.kind "external") }}
{{ printf "database.external.tls is true, but database.kind is %s. Leave it out: tls.mode says how the platform's own database proves who it is." .Values.database.kind }}
{{- else if and .Values.database.external.tls (not $tls.authorities) }}
{{ print "database.external.tls is true, but tls.authorities is empty: nobody could verify the database. Set tls.mode: provided and put the PEM of its authority there, beside that of the broker's." }}
{{- end }}
{{- if and (ne $tls.mode "provided") $tls.provided.secret }}
{{ printf "tls.provided.secret is given, but tls.mode is %s. Set the mode to provided, or leave the Secret out." $tls.mode }}
{{- end }}
{{- if and (eq $tls.mode "cert-manager") (not $tls.issuer.name) }}
{{ print "tls.mode is cert-manager, but tls.issuer.name is empty. Name the Issuer that signs the certificates." }}
{{- end }}
{{- if and (ne $tls.mode "cert-manager") $tls.issuer.name }}
{{ printf "tls.issuer.name is given, but tls.mode is %s. Set the mode to cert-manager, or leave the name out." $tls.mode }}
{{- end }}
{{- if and $external $tls.plain }}
{{ print "tls.plain is true, but broker.kind is external: its listeners are its owner's. Leave it out; tls.mode: \"off\" connects in clear text." }}
{{- end }}
{{- end }}
