{{- /* NetworkPolicies from the table files/network.yaml. */ -}}
{{- define "robotkube.networkTable" -}}
{{ .Files.Get "files/network.yaml" | required "files/network.yaml is not in the chart" }}
{{- end }}

{{- /* The namespaces of each word that stands in the table, as JSON. */ -}}
{{- define "robotkube.networkNamespaces" -}}
{{- $agents := list }}{{ $recording := list }}{{ $test := list }}
{{- range .Values.agents }}
{{- $agents = append $agents .name }}
{{- if .records }}{{ $recording = append $recording .name }}{{ end }}
{{- end }}
{{- if .Values.suites.enabled }}{{ range $i := until (int .Values.suites.pool) }}{{ $test = append $test (include "robotkube.testNamespace" $i) }}{{ end }}{{ end }}
{{- $argocd := list .Values.argocd.namespace }}
{{- toJson (dict "platform" (list .Release.Namespace) "gate" (list (include "robotkube.gateNamespace" .)) "argocd" $argocd "agents" $agents "recording" $recording "test" $test "probe" (list (printf "%s-probe" .Release.Namespace))) }}
{{- end }}

{{- /* What stands elsewhere or is not installed: party -> the ports at which it is reached there, as JSON. Without ports it is nowhere. */ -}}
{{- define "robotkube.networkElsewhere" -}}
{{- $found := dict }}
{{- if eq .Values.forge.kind "external" }}
{{- $ports := list (include "robotkube.portOfUrl" .Values.forge.external.url | int) }}
{{- with .Values.forge.external.api }}{{ $ports = append $ports (include "robotkube.portOfUrl" . | int) }}{{ end }}
{{- if and (ne .Values.forge.external.protocol "gitea") (not .Values.forge.external.api) }}{{ $ports = append $ports 443 }}{{ end }}
{{- $_ := set $found "forge" (uniq $ports) }}
{{- end }}
{{- if eq .Values.broker.kind "external" }}{{ $_ := set $found "broker" (list (int .Values.broker.external.port)) }}{{ end }}
{{- if eq .Values.database.kind "external" }}{{ $_ := set $found "database" (list (int .Values.database.external.port)) }}{{ end }}
{{- if not .Values.suites.enabled }}{{ $_ := set $found "suite-runner" list }}{{ end }}
{{- if not (include "robotkube.inspection" . | fromJson).enabled }}{{ $_ := set $found "inspector" list }}{{ end }}
{{- if not (include "robotkube.remover" . | fromJson).enabled }}{{ $_ := set $found "remover" list }}{{ end }}
{{- if not .Values.admission.enabled }}{{ $_ := set $found "admission" list }}{{ end }}
{{- if not (include "robotkube.rights" . | fromJson).enabled }}{{ $_ := set $found "rights" list }}{{ end }}
{{- if not (include "robotkube.console" . | fromJson).enabled }}{{ $_ := set $found "console" list }}{{ end }}
{{- if not (include "robotkube.consoleForge" .) }}{{ $_ := set $found "console-sign-in" list }}{{ end }}
{{- if not (include "robotkube.certificatesMade" .) }}{{ $_ := set $found "certificates" list }}{{ end }}
{{- if .Values.evidence.existingSecret }}{{ $_ := set $found "gate-key" list }}{{ end }}
{{- if not (include "robotkube.testAgent" .) }}{{ $_ := set $found "installation-test" list }}{{ end }}
{{- $_ := set $found "collector" list }}
{{- with .Values.traces.endpoint }}{{ $_ := set $found "collector" (list (include "robotkube.portOfUrl" . | int)) }}{{ end }}
{{- toJson $found }}
{{- end }}

{{- define "robotkube.portOfUrl" -}}
{{- $host := regexReplaceAll "^https?://([^/]*).*$" . "${1}" }}
{{- regexFind ":[0-9]+$" $host | trimPrefix ":" | default (hasPrefix "https://" . | ternary "443" "80") }}
{{- end }}

{{- /* The pods of a party. Arguments: {root, party}. */ -}}
{{- define "robotkube.networkLabels" -}}
{{- $labels := .party.labels | default dict }}
{{- with .party.component }}{{ $labels = dict "app.kubernetes.io/component" . "app.kubernetes.io/instance" $.root.Release.Name }}{{ end }}
{{- if $labels }}{matchLabels: {{ toJson $labels }}}{{ else }}{}{{ end }}
{{- end }}

{{- /* The ports of an edge: that for clear text only where somebody asks for it. Arguments: {root, edge}. JSON. */ -}}
{{- define "robotkube.networkEdgePorts" -}}
{{- $ports := list .edge.port }}
{{- with .edge.plain }}
{{- $encrypted := include (eq $.edge.to "database" | ternary "robotkube.databaseEncrypted" "robotkube.encrypted") $.root }}
{{- $plain := include (eq $.edge.to "database" | ternary "robotkube.databasePlain" "robotkube.plain") $.root }}
{{- if eq $.edge.to "helper" }}{{ $plain = eq $encrypted "true" | ternary "" "true" }}{{ end }}{{- /* one of a run has one port */}}
{{- if not $encrypted }}{{ $ports = list }}{{ end }}
{{- if $plain }}{{ $ports = append $ports . }}{{ end }}
{{- end }}
{{- toJson $ports }}
{{- end }}

{{- define "robotkube.networkPorts" -}}
{{- $ports := list }}
{{- range .ports }}{{ $ports = append $ports (dict "protocol" $.protocol "port" (int .)) }}{{ end }}
{{- toJson $ports }}
{{- end }}

{{- /* A party as a peer: its pods in its namespaces; nothing when it has none. Arguments: {root, party, namespaces}. */ -}}
{{- define "robotkube.networkPeer" -}}
{{- with get .namespaces .party.namespaces -}}
- namespaceSelector: {matchExpressions: [{key: kubernetes.io/metadata.name, operator: In, values: {{ toJson . }}}]}
  podSelector: {{ include "robotkube.networkLabels" $ }}
{{- end }}
{{- end }}

{{- /* Rules of one edge, as seen by who is reached. Nothing when nobody can be meant: a rule without peers would let everybody in.
       Arguments: {root, table, namespaces, elsewhere, edge}. */ -}}
{{- define "robotkube.networkIngress" -}}
{{- $values := .root.Values.networkPolicies }}
{{- $peers := list }}
{{- range $from := .edge.from }}
{{- if eq $from "api-server" }}{{ $peers = concat $peers ($values.apiServer.to | default list) }}
{{- else if eq $from "metrics" }}{{ $peers = concat $peers ($values.metrics.from | default list) }}
{{- else if eq $from "clients" }}{{ $peers = concat $peers (get $values.clients $.edge.to | default list) }}
{{- else if not (hasKey $.elsewhere $from) }}
{{- $peer := include "robotkube.networkPeer" (dict "root" $.root "party" (index $.table.parties $from) "namespaces" $.namespaces) }}
{{- $peers = concat $peers (fromYamlArray $peer | default list) }}
{{- end }}
{{- end }}
{{- if eq .edge.to "same" }}
- from: [{podSelector: {}}]
{{- else if and $peers .edge.port }}
- from: {{- toYaml $peers | nindent 2 }}
  ports: {{ include "robotkube.networkPorts" (dict "protocol" "TCP" "ports" (include "robotkube.networkEdgePorts" . | fromJsonArray)) }}
{{- end }}
{{- end }}

{{- /* Rules of one edge, as seen by who reaches. Arguments as above. */ -}}
{{- define "robotkube.networkEgress" -}}
{{- $values := .root.Values.networkPolicies }}
{{- $to := .edge.to }}
{{- if eq $to "same" }}
- to: [{podSelector: {}}]
{{- else if eq $to "multicast" }}
- to: [{ipBlock: {cidr: 239.255.0.1/32}}]
  ports: [{protocol: UDP}]
{{- else if eq $to "name-service" }}
- ports: {{ concat (include "robotkube.networkPorts" (dict "protocol" "UDP" "ports" $values.dns.ports) | fromJsonArray) (include "robotkube.networkPorts" (dict "protocol" "TCP" "ports" $values.dns.ports) | fromJsonArray) | toJson }}
  {{- with $values.dns.to }}
  to: {{- toYaml . | nindent 2 }}
  {{- end }}
{{- else if eq $to "api-server" }}
- ports: {{ include "robotkube.networkPorts" (dict "protocol" "TCP" "ports" $values.apiServer.ports) }}
  {{- with $values.apiServer.to }}
  to: {{- toYaml . | nindent 2 }}
  {{- end }}
{{- else if eq $to "kubelets" }}
{{- $kubelets := $values.kubelets | default dict }}
- ports: {{ include "robotkube.networkPorts" (dict "protocol" "TCP" "ports" ($kubelets.ports | default (list 10250))) }}
  {{- with $kubelets.to }}
  to: {{- toYaml . | nindent 2 }}
  {{- end }}
{{- else if hasKey .elsewhere $to }}
{{- with get .elsewhere $to }}
- ports: {{ include "robotkube.networkPorts" (dict "protocol" "TCP" "ports" .) }}
  {{- with $values.outside.to }}
  to: {{- toYaml . | nindent 2 }}
  {{- end }}
{{- end }}
{{- else }}
{{- with include "robotkube.networkPeer" (dict "root" .root "party" (index .table.parties $to) "namespaces" .namespaces) }}
- to: {{- . | nindent 2 }}
  ports: {{ include "robotkube.networkPorts" (dict "protocol" "TCP" "ports" (include "robotkube.networkEdgePorts" $ | fromJsonArray)) }}
{{- end }}
{{- end }}
{{- end }}

{{- /* All policies of a namespace: everything denied, and one policy for each party whose pods stand there. Arguments: {root, table,
       word, namespace, labels}; the word is that of the table. */ -}}
{{- define "robotkube.networkPolicies" -}}
{{- $table := .table }}
{{- $namespaces := include "robotkube.networkNamespaces" .root | fromJson }}
{{- $elsewhere := include "robotkube.networkElsewhere" .root | fromJson }}
{{- if ne .word "recording" }}
---
apiVersion: networking.k8s.io/v1
kind: NetworkPolicy
metadata:
  name: default-deny
  namespace: {{ .namespace }}
  labels: {{- .labels | nindent 4 }}
spec:
  podSelector: {}
  policyTypes: [Ingress, Egress]
{{- end }}
{{- range $name, $party := $table.parties }}
{{- if and (eq $party.namespaces $.word) (not (hasKey $elsewhere $name)) }}
{{- $ingress := "" }}{{ $egress := "" }}
{{- range $edge := $table.edges }}
{{- if or (not $edge.with) (include "robotkube.accountsCertified" $.root) }}{{- /* of `certificates of accounts`, the only one so far */}}
{{- $arguments := dict "root" $.root "table" $table "namespaces" $namespaces "elsewhere" $elsewhere "edge" $edge }}
{{- if or (eq $edge.to $name) (and (eq $edge.to "same") (has $name $edge.from)) }}
{{- $ingress = print $ingress "\n" (include "robotkube.networkIngress" $arguments | trim) }}
{{- end }}
{{- if has $name $edge.from }}{{ $egress = print $egress "\n" (include "robotkube.networkEgress" $arguments | trim) }}{{ end }}
{{- end }}
{{- end }}
{{- with get $.root.Values.networkPolicies.extraIngress $name }}{{ $ingress = print $ingress "\n" (toYaml .) }}{{ end }}
{{- with get $.root.Values.networkPolicies.extraEgress $name }}{{ $egress = print $egress "\n" (toYaml .) }}{{ end }}
{{- $rules := dict "Ingress" (trim $ingress) "Egress" (trim $egress) }}
{{- if or (trim $ingress) (trim $egress) }}
---
apiVersion: networking.k8s.io/v1
kind: NetworkPolicy
metadata:
  name: {{ $name }}
  namespace: {{ $.namespace }}
  labels: {{- $.labels | nindent 4 }}
spec:
  podSelector: {{ include "robotkube.networkLabels" (dict "root" $.root "party" $party) }}
  policyTypes: [Ingress, Egress]
  {{- range $key := list "Ingress" "Egress" }}
  {{- with get $rules $key }}
  {{ lower $key }}:
  {{- regexReplaceAll "\n+" . "\n" | nindent 2 }}
  {{- end }}
  {{- end }}
{{- end }}
{{- end }}
{{- end }}
{{- end }}

{{- /* What is wrong with networkPolicies, one line each. */ -}}
{{- define "robotkube.networkRefusals" -}}
{{- $values := .Values.networkPolicies }}
{{- if $values.enabled }}
{{- $lists := dict "apiServer.to" $values.apiServer.to "dns.to" $values.dns.to "outside.to" $values.outside.to "kubelets.to" (get ($values.kubelets | default dict) "to") "metrics.from" $values.metrics.from }}
{{- range $name, $peers := $values.clients }}{{ $_ := set $lists (printf "clients.%s" $name) $peers }}{{ end }}
{{- range $key, $peers := $lists }}{{ range $i, $peer := $peers }}
{{- if and (hasKey $peer "podSelector") (not (hasKey $peer "namespaceSelector")) }}
{{ printf "networkPolicies.%s[%d]: podSelector alone means pods of whichever namespace a policy stands in. Add a namespaceSelector, such as {matchLabels: {kubernetes.io/metadata.name: monitoring}}." $key $i }}
{{- end }}
{{- if and (hasKey $peer "ipBlock") (gt (len $peer) 1) }}
{{ printf "networkPolicies.%s[%d]: ipBlock and selectors in one peer, which Kubernetes refuses. Make two peers of it." $key $i }}
{{- end }}
{{- end }}{{ end }}
{{- range $name, $_ := $values.extraIngress }}{{ include "robotkube.networkUnused" (dict "root" $ "key" "extraIngress" "name" $name) }}{{ end }}
{{- range $name, $_ := $values.extraEgress }}{{ include "robotkube.networkUnused" (dict "root" $ "key" "extraEgress" "name" $name) }}{{ end }}
{{- end }}
{{- end }}

{{- /* Rules for what this installation does not have would be dropped without a word. Arguments: {root, key, name}. */ -}}
{{- define "robotkube.networkUnused" -}}
{{- $party := index (include "robotkube.networkTable" .root | fromYaml).parties .name }}
{{- $namespaces := include "robotkube.networkNamespaces" .root | fromJson }}
{{- if or (hasKey (include "robotkube.networkElsewhere" .root | fromJson) .name) (not (get $namespaces $party.namespaces)) }}
{{ printf "networkPolicies.%s.%s: these values install no pods of this name. Take the rules out." .key .name }}
{{- end }}
{{- end }}
