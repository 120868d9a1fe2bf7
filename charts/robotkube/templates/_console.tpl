{{- /* The values of console, also when an upgrade reuses values from before there were any. */ -}}
{{- define "robotkube.console" -}}
{{- include "robotkube.once" (dict "root" . "of" "robotkube.consoleOfValues") -}}
{{- end }}

{{- define "robotkube.consoleOfValues" -}}
{{- $console := dict "enabled" false "anybodyReads" false "hosts" list "proxies" list "poseTopic" "mqtt/vehicles/{agent}/pose" }}
{{- $_ := set $console "links" (dict "forge" "" "argocd" "") }}
{{- $_ := set $console "signIn" (dict "forge" false "issuer" "" "clientId" "" "secret" "" "url" "" "groups" list "usernameClaim" "preferred_username" "groupsClaim" "groups" "scopes" list "writers" list) }}
{{- $_ := set $console "resources" (dict "requests" (dict "cpu" "50m" "memory" "128Mi") "limits" (dict "memory" "512Mi")) }}
{{- range $key, $value := .Values.console | default dict }}
{{- if has $key (list "links" "signIn") }}{{ $value = merge (deepCopy $value) (get $console $key) }}{{ end }}
{{- $_ := set $console $key $value }}
{{- end }}
{{- toJson $console }}
{{- end }}

{{- /* "true" where people sign in at the console by the forge that is installed here, else empty. */ -}}
{{- define "robotkube.consoleForge" -}}
{{- $console := include "robotkube.console" . | fromJson -}}
{{- if and $console.enabled $console.signIn.forge (eq .Values.forge.kind "gitea") }}true{{ end -}}
{{- end }}

{{- /* The client at the forge by which they do: its name there, and the ConfigMap by which its id reaches the console. YAML. */ -}}
{{- define "robotkube.consoleClient" -}}
{{- $console := include "robotkube.console" . | fromJson -}}
{name: robotkube-console, redirect: "{{ $console.signIn.url }}/auth/callback", config_map: {namespace: {{ .Release.Namespace }}, name: console-sign-in}}
{{- end }}

{{- /* The groups whose members may read: those of the values, or who may propose changes of what runs. JSON. */ -}}
{{- define "robotkube.consoleReaders" -}}
{{- $signIn := (include "robotkube.console" . | fromJson).signIn -}}
{{ $signIn.groups | default ($signIn.forge | ternary (list "robotkube:deployment-write") list) | toJson }}
{{- end }}

{{- /* "true" where poses are shown: with a broker that is installed here, which has the account that may only read. */ -}}
{{- define "robotkube.consolePoses" -}}
{{- if eq .Values.broker.kind "mosquitto" }}true{{ end -}}
{{- end }}

{{- /* The names by which browsers reach the console: its Service's, those of the values, and that of its own address. JSON. */ -}}
{{- define "robotkube.consoleHosts" -}}
{{- $console := include "robotkube.console" . | fromJson -}}
{{- $short := printf "console.%s" .Release.Namespace -}}
{{- $hosts := list (include "robotkube.host" (dict "root" . "name" "console")) (printf "%s.svc" $short) $short "console" "localhost" -}}
{{- with $console.signIn.url }}{{ $hosts = append $hosts (regexReplaceAll "^https?://([^/:]*).*$" . "${1}") }}{{ end -}}
{{ concat $hosts $console.hosts | uniq | toJson }}
{{- end }}

{{- define "robotkube.consoleSettings" -}}
{{- $console := include "robotkube.console" . | fromJson -}}
listen: {address: 0.0.0.0, port: 8080, health_port: 8081}
log_level: {{ .Values.logLevel }}
{{- with include "robotkube.processAuthorities" . }}
{{ . }}
{{- end }}
namespaces: {platform: {{ .Release.Namespace }}, argocd: {{ .Values.argocd.namespace }}}
agents:
{{- include "robotkube.agents" . }}
managers:
{{- range fromJsonArray (include "robotkube.managers" .) }}
- name: {{ .name }}
  url: "{{ include "robotkube.processScheme" $ }}://{{ include "robotkube.host" (dict "root" $ "name" .name) }}:8080"
  namespaces: {{ toJson .scope.namespaces }}
{{- end }}
gate: {url: "{{ include "robotkube.processScheme" . }}://{{ include "robotkube.gateHost" . }}:8080"}
{{- if include "robotkube.accountsCertified" . }}
certificates: {url: "http://{{ include "robotkube.host" (dict "root" . "name" "certificates") }}:8081"}
{{- end }}
hosts: {{ include "robotkube.consoleHosts" . }}
{{- with $console.proxies }}
proxies: {{ toJson . }}
{{- end }}
links: {{ include "robotkube.consoleLinks" $console }}
page: /opt/robotkube/console
{{- if include "robotkube.consolePoses" . }}
poses: {topic: {{ toJson $console.poseTopic }}}
broker:
  {{- include "robotkube.brokerSettings" . | nindent 2 }}
{{- end }}
{{- $byForge := include "robotkube.consoleForge" . }}
{{- if or $console.signIn.issuer $byForge }}
sign_in:
  {{- if $byForge }}
  issuer: {{ include "robotkube.forgeUrl" . }}
  pages: {{ $console.links.forge }}
  client_id_file: /etc/robotkube/sign-in/client_id
  by_id_token: true
  {{- else }}
  issuer: {{ $console.signIn.issuer }}
  client_id: {{ toJson $console.signIn.clientId }}
  {{- end }}
  {{- if $console.signIn.secret }}
  client_secret: /var/run/secrets/robotkube/sign-in/secret
  {{- end }}
  url: {{ $console.signIn.url }}
  groups: {{ include "robotkube.consoleReaders" . }}
  username_claim: {{ $console.signIn.usernameClaim }}
  groups_claim: {{ $console.signIn.groupsClaim }}
  {{- with $console.signIn.scopes }}
  scopes: {{ toJson . }}
  {{- end }}
  {{- with $console.signIn.writers }}
  writers: {{ toJson . }}
  {{- end }}
  {{- if include "robotkube.encrypted" . }}
  authorities: /etc/robotkube/authorities/ca.crt
  {{- end }}
{{- else if $console.anybodyReads }}
anybody_reads: true
{{- else }}
by_forward: true
{{- end }}
{{- end }}

{{- /* "true" where the console answers forwards of the API server's alone, else empty. */ -}}
{{- define "robotkube.consoleByForward" -}}
{{- $console := include "robotkube.console" . | fromJson -}}
{{- if and $console.enabled (not $console.anybodyReads) (not $console.signIn.issuer) (not $console.signIn.forge) }}true{{ end -}}
{{- end }}

{{- /* Addresses of other pages, those that are given. JSON. */ -}}
{{- define "robotkube.consoleLinks" -}}
{{- $links := dict }}
{{- range $key, $url := .links }}{{ if $url }}{{ $_ := set $links $key $url }}{{ end }}{{ end -}}
{{ toJson $links }}
{{- end }}

{{- /* The groups of writers as the API server has them, none of which is a group of the cluster's own. JSON. */ -}}
{{- define "robotkube.consoleGroups" -}}
{{- $groups := list }}{{ range . }}{{ $groups = append $groups (printf "robotkube:console:%s" .group) }}{{ end -}}
{{ $groups | uniq | sortAlpha | toJson }}
{{- end }}

{{- /* What is wrong with the values of console, one line each. */ -}}
{{- define "robotkube.consoleRefusals" -}}
{{- $console := include "robotkube.console" . | fromJson }}
{{- if $console.enabled }}
{{- $signIn := $console.signIn }}
{{- if and (not $signIn.issuer) (not $signIn.forge) (not $console.anybodyReads) }}
{{- $given := list }}{{ range list "clientId" "secret" "url" "groups" }}{{ if index $signIn . }}{{ $given = append $given . }}{{ end }}{{ end }}
{{- if $given }}
{{ printf "console.signIn has %s, but nobody can sign in: console.signIn.issuer is empty. Name the provider of accounts, set console.signIn.forge: true for those of the chart's own forge, or take them out: then who may forward ports to the console's pod reads." (join ", " $given) }}
{{- end }}
{{- end }}
{{- if and (include "robotkube.consoleByForward" .) .Values.networkPolicies.clients.console }}
{{ print "networkPolicies.clients.console names who reaches the console, but it answers forwards alone. Have people sign in (console.signIn.forge or issuer), let everybody who reaches it read (console.anybodyReads: true), or take the clients out." }}
{{- end }}
{{- if $signIn.forge }}{{ include "robotkube.consoleForgeRefusals" . }}{{ end }}
{{- if and $signIn.issuer (not $signIn.forge) (not (and $signIn.clientId $signIn.url $signIn.groups)) }}
{{ print "console.signIn: issuer needs clientId (of the client at the provider), url (the console's own address in a browser) and groups (whose members may read)." }}
{{- end }}
{{- if and $signIn.writers (not $signIn.issuer) (not $signIn.forge) }}
{{ print "console.signIn.writers names groups, but console.signIn.issuer is empty: without signing in nobody writes. Name the provider of accounts, or take writers out." }}
{{- end }}
{{- $agents := list }}{{ range .Values.agents }}{{ $agents = append $agents .name }}{{ end }}
{{- $readers := include "robotkube.consoleReaders" . | fromJsonArray }}
{{- range $writer := $signIn.writers }}
{{- range $writer.namespaces }}{{ if not (has . $agents) }}
{{ printf "console.signIn.writers: group %s may ask in namespace %s, which is no agent's. Name agents (%s)." $writer.group . (join ", " $agents) }}
{{- end }}{{ end }}
{{- if not (has $writer.group $readers) }}
{{ printf "console.signIn.writers: group %s is not in console.signIn.groups, so its members may not even read. Add it there." $writer.group }}
{{- end }}
{{- end }}
{{- if and $signIn.issuer $console.anybodyReads }}
{{ print "console.anybodyReads is true, but console.signIn.issuer is set. Take one of the two out." }}
{{- end }}
{{- end }}
{{- end }}

{{- /* The host name in an address, in lower case. */ -}}
{{- define "robotkube.hostOfUrl" -}}
{{ regexReplaceAll "^https?://([^/:]*).*$" . "${1}" | lower }}
{{- end }}

{{- /* What is wrong with the values of signing in by the chart's own forge, one line each. */ -}}
{{- define "robotkube.consoleForgeRefusals" -}}
{{- $console := include "robotkube.console" . | fromJson }}
{{- $signIn := $console.signIn }}
{{- $pages := $console.links.forge }}
{{- if eq .Values.forge.kind "external" }}
{{ print "console.signIn.forge is true, but forge.kind is external: the chart cannot register a client there. Register one, and name it in console.signIn.issuer and clientId." }}
{{- end }}
{{- if or $signIn.issuer $signIn.clientId $signIn.secret }}
{{ print "console.signIn.forge is true, but issuer, clientId or secret is set, which are of another provider. Take out those, or forge." }}
{{- end }}
{{- if $console.anybodyReads }}
{{ print "console.anybodyReads is true, but console.signIn.forge is, too. Take one of the two out." }}
{{- end }}
{{- if not (and $signIn.url $pages) }}
{{ print "console.signIn.forge is true, but console.signIn.url or console.links.forge is empty: browsers go from the one to the other and back. Give both as people see them; with port-forwards these are http://127.0.0.1:8080 and https://localhost:3000." }}
{{- else }}
{{- if eq (include "robotkube.hostOfUrl" $signIn.url) (include "robotkube.hostOfUrl" $pages) }}
{{ printf "console.signIn.url and console.links.forge have the same host name, %s: a browser would show the console the cookie by which somebody is signed in at the forge, at whatever port. Give each a name of its own." (include "robotkube.hostOfUrl" $pages) }}
{{- end }}
{{- if regexMatch "^https?://[^/]+/" $pages }}
{{ printf "console.links.forge is %s: the forge's pages lead to each other from the top of their host, so nobody can sign in below a path. Give it a host of its own." $pages }}
{{- end }}
{{- if and (include "robotkube.forgeEncrypted" .) (hasPrefix "http://" $pages) }}
{{ printf "console.links.forge is %s, but the forge speaks HTTPS, and browsers send its cookies by TLS alone: nobody could sign in. Give an address with https://, or set forge.tls: false." $pages }}
{{- end }}
{{- end }}
{{- end }}
