{{- /* Settings files. Form: docs/reference/settings.md. */ -}}
{{- /* Arguments: {root, manager}. */ -}}
{{- define "robotkube.managerSettings" -}}
{{- $manager := .manager }}
{{- with .root -}}
{{ include "robotkube.listen" . }}
log_level: {{ .Values.logLevel }}
{{- with include "robotkube.processAuthorities" . }}
{{ . }}
{{- end }}
forge:
  {{- include "robotkube.forgeAddress" . | nindent 2 }}
  credentials: /var/run/secrets/robotkube/forge
  deployment: robotkube/deployment
  catalogue: robotkube/catalogue
  branch: main
oci_registry:
  charts: {{ include "robotkube.charts" . }}
{{- $server := include "robotkube.argocdServer" . | fromJson }}
argocd:
  url: {{ $server.url }}
  {{- if $server.authorities }}
  authorities: /etc/robotkube/argocd/ca.crt
  {{- end }}
  credentials: /var/run/secrets/robotkube/argocd
  namespace: {{ .Values.argocd.namespace }}
  project: robotkube-apps
hook:
  url: {{ include "robotkube.hookUrl" . }}
  secret: /var/run/secrets/robotkube/hook/secret
webhook:
  secret: /var/run/secrets/robotkube/webhook/secret
evidence:
  keys: /etc/robotkube/keys
gate:
  objects: {{ include "robotkube.processScheme" . }}://{{ include "robotkube.gateHost" . }}:8080/objects/{{ $manager.name }}
lease: {namespace: {{ .Release.Namespace }}, name: robotkube-manager-{{ $manager.name }}{{ if include "robotkube.processesEncrypted" . }}, server_name: {{ include "robotkube.host" (dict "root" . "name" $manager.name) }}{{ end }}}
agents:
{{- include "robotkube.agents" . }}
broker:
  {{- include "robotkube.brokerSettings" . | nindent 2 }}
scope: {{ toJson $manager.scope }}
operators: {{ toJson $manager.operators }}
managers:
{{- range fromJsonArray (include "robotkube.managers" .) }}
- {name: {{ .name }}, scope: {{ toJson .scope }}}
{{- end }}
node_lost_seconds: {{ $manager.nodeLostSeconds }}
{{- with .Values.traces.endpoint }}
traces: {endpoint: {{ . }}}
{{- end }}
{{- end }}
{{- end }}

{{- define "robotkube.gateSettings" -}}
{{ include "robotkube.listen" . }}
log_level: {{ .Values.logLevel }}
{{- with include "robotkube.processAuthorities" . }}
{{ . }}
{{- end }}
forge:
  {{- include "robotkube.forgeAddress" . | nindent 2 }}
  credentials: /var/run/secrets/robotkube/forge
  deployment: robotkube/deployment
  catalogue: robotkube/catalogue
  branch: main
  proposers:
  {{- range $manager := fromJsonArray (include "robotkube.managers" .) }}
  - account: {{ .name }}
    namespaces: [{{ include "robotkube.managerAgents" (dict "root" $ "manager" .) | replace " " ", " }}]
    webhook: {{ include "robotkube.processScheme" $ }}://{{ include "robotkube.host" (dict "root" $ "name" .name) }}:8080/webhook
    secret: /var/run/secrets/robotkube/proposers/{{ .name }}/secret
  {{- end }}
  publishers: [publisher]
oci_registry:
  charts: {{ include "robotkube.charts" . }}
  staging: {{ include "robotkube.packages" (dict "root" . "organisation" "staging") }}
local_builds: {{ .Values.gate.localBuilds }}
{{- with include "robotkube.reservedAgents" . }}
reserved_agents: [{{ . }}]
{{- end }}
evidence:
  key: /var/run/secrets/robotkube/key/key.pem
  keys: /etc/robotkube/keys
  verifier: robotkube-gate
{{- if .Values.suites.enabled }}
suites:
  url: {{ include "robotkube.processScheme" . }}://{{ include "robotkube.host" (dict "root" . "name" "suite-runner") }}:8080
  token: /var/run/secrets/robotkube/suite-runner/token
{{- end }}
hook:
  url: {{ include "robotkube.hookUrl" . }}
  secret: /var/run/secrets/robotkube/hook/secret
webhook:
  secret: /var/run/secrets/robotkube/webhook/secret
{{- end }}

{{- define "robotkube.bootstrapSettings" -}}
{{- $rights := include "robotkube.rights" . | fromJson -}}
{{- $readers := include "robotkube.managerNames" . | replace " " ": read, " -}}
{{- $people := include "robotkube.people" . | replace " " ": write, " -}}
{{- $viewers := include "robotkube.viewers" . | replace " " ": pulls, " -}}
log_level: {{ .Values.logLevel }}
wait_seconds: {{ .Values.bootstrap.waitSeconds | int }}
{{- if eq .Values.forge.kind "gitea" }}
forge:
  url: {{ include "robotkube.forgeUrl" . }}
  {{- with include "robotkube.forgeAuthorities" . }}
  {{ . }}
  {{- end }}
  administrator: /var/run/secrets/robotkube/forge/administrator
  accounts:
  {{- range splitList " " (include "robotkube.forgeAccounts" .) }}
  - {name: {{ . }}, credentials: /var/run/secrets/robotkube/forge/{{ . }}}
  {{- end }}
  organisations:
  - {name: robotkube, packages: {image-publisher: write, gate: read, suite-runner: read, nodes: read}}
  - {name: staging-publisher, packages: {publisher: write, gate: read, suite-runner: read}}
  - {name: staging, packages: {gate: write, suite-runner: read}}
  - {name: own-images, packages: {gate: write, suite-runner: read, nodes: read}}
  - {name: verified, packages: {gate: write, {{ $readers }}: read, argocd: read, suite-runner: read, inspector: read}}
  repositories:
  - name: robotkube/deployment
    description: What runs on the fleet, one file per release
    branch: main
    seed: /etc/robotkube/seed/deployment
    access: { {{- $readers }}: read, gate: write, argocd: read, inspector: read, {{ if $rights.enabled }}rights: read, {{ end }}{{ with $viewers }}{{ . }}: pulls, {{ end }}{{ $people }}: write}
    main: [gate]
  - name: robotkube/catalogue
    description: What may be deployed
    branch: main
    seed: /etc/robotkube/seed/catalogue
    access: { {{- $readers }}: read, gate: write, publisher: read, inspector: read, {{ if .Values.admission.enabled }}admission: read, {{ end }}{{ with $viewers }}{{ . }}: pulls, {{ end }}{{ $people }}: write}
    main: [gate]
  {{- $otherwise := list }}
  webhooks:
  {{- range $process := splitList " " (include "robotkube.hearers" .) }}
  {{- $secret := printf "/var/run/secrets/robotkube/webhook/%s/secret" $process }}
  {{- $host := eq $process "gate" | ternary (include "robotkube.gateHost" $) (include "robotkube.host" (dict "root" $ "name" $process)) }}
  {{- $url := printf "%s://%s:8080/webhook" (include "robotkube.processScheme" $) $host }}
  {{- $other := printf "%s://%s:8080/webhook" (include "robotkube.processesEncrypted" $ | eq "true" | ternary "http" "https") $host }}
  {{- $events := eq $process "gate" | ternary "[push, pull_request, pull_request_comment]" "[push, pull_request]" }}
  {{- if eq $process "rights" }}{{ $events = "[push]" }}{{ end }}
  {{- if ne $process "admission" }}
  {{- $otherwise = append $otherwise (dict "repository" "robotkube/deployment" "url" $other) }}
  - {repository: robotkube/deployment, url: {{ $url | quote }}, events: {{ $events }}, secret: {{ $secret }}}
  {{- end }}
  {{- $events = eq $process "gate" | ternary "[push, pull_request]" "[push]" }}
  {{- if ne $process "rights" }}
  {{- $otherwise = append $otherwise (dict "repository" "robotkube/catalogue" "url" $other) }}
  - {repository: robotkube/catalogue, url: {{ $url | quote }}, events: {{ $events }}, secret: {{ $secret }}}
  {{- end }}
  {{- end }}
  former_webhooks:                # where the gate stood before it had a namespace of its own, and what tls.processes changed
  {{- range list "deployment" "catalogue" }}
  - {repository: robotkube/{{ . }}, url: "http://{{ include "robotkube.host" (dict "root" $ "name" "gate") }}:8080/webhook"}
  {{- end }}
  {{- range $otherwise }}
  - {repository: {{ .repository }}, url: {{ .url | quote }}}
  {{- end }}
  {{- if include "robotkube.consoleForge" . }}
  sign_in_clients:
  - {{ include "robotkube.consoleClient" . }}
  {{- end }}
{{- end }}
{{- if ne .Values.database.kind "external" }}
database:
  kind: {{ .Values.database.kind }}
  host: {{ include "robotkube.databaseHost" . }}
  port: {{ include "robotkube.databasePort" . }}
  {{- if include "robotkube.databaseEncrypted" . }}
  authorities: /etc/robotkube/authorities/ca.crt
  {{- end }}
  administrator: /var/run/secrets/robotkube/database/administrator
  accounts:
  {{- range .Values.agents }}{{ if .records }}
  - {username: {{ include "robotkube.database" .name }}, database: {{ include "robotkube.database" .name }}, credentials: /var/run/secrets/robotkube/database/{{ .name }}}
  {{- end }}{{ else }} []
  {{- end }}
{{- end }}
argocd:
  namespace: {{ .Values.argocd.namespace }}
  account: {name: manager, credentials: /var/run/secrets/robotkube/argocd}
  rbac: |
    p, role:robotkube-manager, applications, get, robotkube-apps/*, allow
    g, manager, role:robotkube-manager
  hook: {secret: /var/run/secrets/robotkube/hook/secret}
  closed_project: default
  hook_readers: [argocd-server, argocd-applicationset-controller]
  {{- if include "robotkube.forgeEncrypted" . }}
  trust_readers: [argocd-repo-server]
  {{- end }}
{{- end }}

{{- define "robotkube.suiteRunnerSettings" -}}
{{ include "robotkube.listen" . }}
log_level: {{ .Values.logLevel }}
forge:
  url: {{ include "robotkube.forgeUrl" . }}
  {{- with include "robotkube.forgeAuthorities" . }}
  {{ . }}
  {{- end }}
  credentials: /var/run/secrets/robotkube/forge
oci_registry:
  {{- range list "staging" "verified" }}
  {{ . }}: {{ include "robotkube.packages" (dict "root" $ "organisation" .) }}
  {{- end }}
  images: {{ include "robotkube.packages" (dict "root" . "organisation" "robotkube") }}
token: /var/run/secrets/robotkube/suite-runner/token
platform_namespace: {{ .Release.Namespace }}
tls: {{ include "robotkube.encrypted" . | eq "true" }}
kubelets: {verify: {{ (include "robotkube.inspection" . | fromJson).verifyKubelets }}}
agent: {{ include "robotkube.suitesAgent" . }}
test_namespaces:
{{- range $i := until (int .Values.suites.pool) }}
- {namespace: {{ include "robotkube.testNamespace" $i }}, domain_id: {{ add 90 $i }}}
{{- end }}
images:
  observer: {{ include "robotkube.image" (dict "root" . "name" "ros") }}
  broker: {{ include "robotkube.image" (dict "root" . "name" "mosquitto") }}
{{- $kind := include "robotkube.suitesDatabase" . }}
{{- if not $kind }}
  database: ""
database: {kind: "", arguments: []}         # none: charts that name a database account are refused
{{- else }}
  database: {{ include "robotkube.image" (dict "root" . "name" $kind) }}
database:
  kind: {{ $kind }}
  arguments: {{ toJson .Values.database.arguments }}
{{- end }}
{{- end }}

{{- define "robotkube.gateKeySettings" -}}
log_level: {{ .Values.logLevel }}
secret: {namespace: {{ include "robotkube.gateNamespace" . }}, name: gate-key}
public_keys: {namespaces: [{{ include "robotkube.gateNamespace" . }}, {{ .Release.Namespace }}], name: gate-public-key}
former_key: /var/run/secrets/robotkube/former/key.pem          # of the namespace where the gate stood before; there or not
{{- end }}

{{- define "robotkube.teardownSettings" -}}
log_level: {{ .Values.logLevel }}
argocd: {namespace: {{ .Values.argocd.namespace }}, project: robotkube-apps, application_set: releases}
wait_seconds: {{ .Values.teardown.waitSeconds | int }}
{{- end }}

{{- define "robotkube.installationTestSettings" -}}
log_level: {{ .Values.logLevel }}
agent: {{ include "robotkube.testAgent" . }}
application: {{ (include "robotkube.installationTest" . | fromJson).application }}
parameters: {{ include "robotkube.testParameters" . }}
database: /var/run/secrets/robotkube/database
platform_namespace: {{ .Release.Namespace }}
argocd_namespace: {{ .Values.argocd.namespace }}
{{- end }}

{{- /* Pod fields of a process that reads such a file. Arguments: {root, component}. */ -}}
{{- define "robotkube.settingsAnnotation" -}}
robotkube.io/settings: {{ include (printf "robotkube.%sSettings" .component) .root | sha256sum | trunc 16 | quote }}
{{- end }}

{{- define "robotkube.processEnvironment" -}}
env:
- {name: POD_NAME, valueFrom: {fieldRef: {fieldPath: metadata.name}}}
- {name: POD_NAMESPACE, valueFrom: {fieldRef: {fieldPath: metadata.namespace}}}
- {name: HOME, value: /tmp}
{{- end }}
