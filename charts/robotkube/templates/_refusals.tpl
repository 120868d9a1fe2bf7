{{- /* Everything that is wrong with the values, found in one pass and said at once, each with its fix. The schema has checked types and
       unknown keys before. */ -}}
{{- define "robotkube.refusals" -}}
{{- $problems := list }}
{{- $roles := list "cloud" "edge" "roadside" "vehicle" }}
{{- $taken := list .Release.Namespace (include "robotkube.gateNamespace" .) .Values.argocd.namespace "default" "kube-system" "kube-public" "kube-node-lease" "observer" "rights" }}
{{- if .Values.suites.enabled }}{{ range $i := until (int .Values.suites.pool) }}{{ $taken = append $taken (include "robotkube.testNamespace" $i) }}{{ end }}{{ end }}
{{- $seen := list }}
{{- range $i, $agent := .Values.agents }}
{{- $at := printf "agents[%d] %q" $i $agent.name }}
{{- if not (regexMatch "^[a-z]([-a-z0-9]*[a-z0-9])?$" $agent.name) }}
{{- $problems = append $problems (printf "%s: the name becomes a namespace and a ROS name. Use lower case letters, digits and hyphens, a letter first, such as vehicle-00." $at) }}
{{- end }}
{{- if gt (len $agent.name) 22 }}
{{- $problems = append $problems (printf "%s: %d characters; Argo CD's <namespace>-<release> has 53, of which a release needs up to 30. Use at most 22." $at (len $agent.name)) }}
{{- end }}
{{- if has $agent.name $seen }}
{{- $problems = append $problems (printf "%s: declared twice. Give each agent a name of its own." $at) }}
{{- end }}
{{- if has $agent.name $taken }}
{{- $problems = append $problems (printf "%s: this namespace belongs to the cluster or the platform. Use another name." $at) }}
{{- end }}
{{- if $agent.reserved }}
{{- if $agent.role }}
{{- $problems = append $problems (printf "%s: has a role and is reserved. Leave the role out, main gives it when the agent is enrolled, or reserved for an agent that is there from the beginning." $at) }}
{{- end }}
{{- else if not $agent.role }}
{{- $problems = append $problems (printf "%s: has no role. Give one of %s, or reserved: true for an agent that main enrolls later." $at (join ", " $roles)) }}
{{- else if not (has $agent.role $roles) }}
{{- $problems = append $problems (printf "%s: unknown role %q. Use one of: %s." $at $agent.role (join ", " $roles)) }}
{{- end }}
{{- $claims := list }}
{{- range $claim := $agent.claims }}
{{- if eq $claim.name "recordings" }}
{{- $problems = append $problems (printf "%s: volume claim \"recordings\" is made by records: true. Set that, or use another name." $at) }}
{{- end }}
{{- if has $claim.name $claims }}
{{- $problems = append $problems (printf "%s: volume claim %q is declared twice. Remove one." $at $claim.name) }}
{{- end }}
{{- if not (regexMatch "^[a-z0-9]([-a-z0-9]{0,61}[a-z0-9])?$" $claim.name) }}
{{- $problems = append $problems (printf "%s: volume claim name %q. Use lower case letters, digits and hyphens." $at $claim.name) }}
{{- end }}
{{- $claims = append $claims $claim.name }}
{{- end }}
{{- $seen = append $seen $agent.name }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.managerRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.installationTestRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.peopleRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.networkRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.tlsRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.argocdRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.consoleRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.podRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- if not .Values.images.platform }}
{{- $problems = append $problems "images.platform is empty. Give the reference of the platform image, such as registry.example/robotkube/platform@sha256:..." }}
{{- end }}
{{- if and (eq .Values.database.kind "ferretdb") (not .Values.images.ferretdb) }}
{{- $problems = append $problems "database.kind is ferretdb, but images.ferretdb is empty. Give its reference, or use database.kind: mongo." }}
{{- end }}
{{- if and (eq .Values.database.kind "mongo") (not .Values.images.mongo) }}
{{- $problems = append $problems "database.kind is mongo, but images.mongo is empty. Give its reference." }}
{{- end }}
{{- if and (eq .Values.broker.kind "mosquitto") (not .Values.images.mosquitto) }}
{{- $problems = append $problems "broker.kind is mosquitto, but images.mosquitto is empty. Give its reference." }}
{{- end }}
{{- if and (eq .Values.forge.kind "gitea") (not .Values.images.gitea) }}
{{- $problems = append $problems "forge.kind is gitea, but images.gitea is empty. Give its reference." }}
{{- end }}
{{- range $part := list "broker" "database" }}
{{- $values := index $.Values $part }}
{{- if and (eq $values.kind "external") (not $values.external.host) }}
{{- $problems = append $problems (printf "%s.kind is external, but %s.external.host is empty. Give the host name." $part $part) }}
{{- end }}
{{- if and (ne $values.kind "external") $values.external.host }}
{{- $problems = append $problems (printf "%s.external.host is given, but %s.kind is %s. Set the kind to external, or leave the host out." $part $part $values.kind) }}
{{- end }}
{{- end }}
{{- $url := .Values.forge.external.url }}
{{- if and (eq .Values.forge.kind "external") (not (regexMatch "^https?://[^/]+$" $url)) }}
{{- $problems = append $problems (printf "forge.kind is external, but forge.external.url is %q. Give http(s)://<host>[:<port>] without a path or a slash at the end." $url) }}
{{- end }}
{{- $api := .Values.forge.external.api }}
{{- if and $api (eq .Values.forge.external.protocol "gitea") }}
{{- $problems = append $problems "forge.external.api is given, but forge.external.protocol is gitea, whose API stands below its url. Leave the api out, or set the protocol." }}
{{- end }}
{{- if and $api (not (regexMatch "^https?://[^/]+(/[^/]+)*$" $api)) }}
{{- $problems = append $problems (printf "forge.external.api is %q. Give http(s)://<host>[:<port>]/<path> without a slash at the end." $api) }}
{{- end }}
{{- if and (ne .Values.forge.kind "external") $url }}
{{- $problems = append $problems (printf "forge.external.url is given, but forge.kind is %s. Set the kind to external, or leave the url out." .Values.forge.kind) }}
{{- end }}
{{- $seed := .Values.secrets.seed }}
{{- if and $seed (lt (len $seed) 32) }}
{{- $problems = append $problems "secrets.seed is shorter than 32 characters. All passwords follow from it: give more, or leave it out." }}
{{- end }}
{{- $kept := lookup "v1" "Secret" .Release.Namespace "robotkube-seed" | dig "data" "seed" "" | b64dec }}
{{- if and $seed $kept (ne $seed $kept) }}
{{- $problems = append $problems "secrets.seed differs from the one kept in the Secret robotkube-seed: forge and database would refuse the new passwords. Leave secrets.seed out, or delete the Secret together with the volume claims forge and database." }}
{{- end }}
{{- if .Values.suites.enabled }}
{{- $off := "or set suites.enabled: false (then charts are verified and published elsewhere)." }}
{{- range $image, $use := dict "suites" "the suite-runner's image" "ros" "what observes charts under test" }}
{{- if not (index $.Values.images $image) }}
{{- $problems = append $problems (printf "suites.enabled is true, but images.%s (%s) is empty. Give its reference, %s" $image $use $off) }}
{{- end }}
{{- end }}
{{- if and (eq .Values.broker.kind "external") (not .Values.images.mosquitto) }}
{{- $problems = append $problems (printf "suites.enabled is true, but images.mosquitto, the broker that suites start, is empty. Give its reference, %s" $off) }}
{{- end }}
{{- if and (not (hasKey .Values.suites "testNamespace")) (lt (len (.Values.suites.room | default dict)) 2) }}
{{- $problems = append $problems "suites.testNamespace is empty: the pods of a test namespace would have no limit. Give cpu and memory, or leave it out." }}
{{- end }}
{{- range $key := list "cpu" "memory" }}
{{- $former := get ($.Values.suites.room | default dict) $key }}
{{- $now := get ($.Values.suites.testNamespace | default dict) $key }}
{{- if and $former $now (ne $now $former) }}
{{- $problems = append $problems (printf "suites.room.%s is %q, but suites.testNamespace.%s, its new name, is %q. Remove suites.room." $key $former $key $now) }}
{{- end }}
{{- end }}
{{- if not (include "robotkube.suitesAgent" .) }}
{{- $problems = append $problems (printf "suites.enabled is true, but no agent has role cloud and suites.agent is empty: suites need an agent to run on. Declare one, name one of agents in suites.agent, %s" $off) }}
{{- else if and .Values.suites.agent (not (has .Values.suites.agent $seen)) }}
{{- $problems = append $problems (printf "suites.agent: %q is none of agents. Use one of: %s." .Values.suites.agent (join ", " $seen)) }}
{{- else if and .Values.suites.agent (has .Values.suites.agent (include "robotkube.reservedAgents" . | splitList ", ")) }}
{{- $problems = append $problems (printf "suites.agent: %q is reserved, and may have no Node. Use an agent that has a role." .Values.suites.agent) }}
{{- end }}
{{- end }}
{{- if .Values.admission.enabled }}
{{- $unused := list }}
{{- $database := .Values.suites.enabled | ternary (include "robotkube.suitesDatabase" .) .Values.database.kind }}
{{- range $kind := list "mongo" "ferretdb" }}{{ if ne $kind $database }}{{ $unused = append $unused $kind }}{{ end }}{{ end }}
{{- if ne .Values.forge.kind "gitea" }}{{ $unused = append $unused "gitea" }}{{ end }}
{{- if not .Values.suites.enabled }}{{ $unused = concat $unused (list "suites" "ros") }}{{ end }}
{{- if and (ne .Values.broker.kind "mosquitto") (not .Values.suites.enabled) }}{{ $unused = append $unused "mosquitto" }}{{ end }}
{{- range $name, $reference := .Values.images }}
{{- if and $reference (not (has $name $unused)) (not (regexMatch "@sha256:[0-9a-f]{64}$" $reference)) }}
{{- $problems = append $problems (printf "admission.enabled is true, but images.%s is %q, which names no digest: its pods would be refused. Give <repository>@sha256:<digest>, or set admission.enabled: false." $name $reference) }}
{{- end }}
{{- end }}
{{- end }}
{{- if and (include "robotkube.remover" . | fromJson).enabled (not (include "robotkube.inspection" . | fromJson).enabled) }}
{{- $problems = append $problems "remover.enabled is true, but inspection.enabled is false: nobody names what is to be removed. Set inspection.enabled: true, or remover.enabled: false." }}
{{- end }}
{{- range $line := splitList "\n" (include "robotkube.evidenceRefusals" .) }}
{{- if trim $line }}{{ $problems = append $problems (trim $line) }}{{ end }}
{{- end }}
{{- if $problems }}
{{- $text := printf "robotkube: %d problem(s) in the values, nothing was changed:" (len $problems) }}
{{- range $i, $problem := $problems }}
{{- $text = printf "%s\n  %d. %s" $text (add1 $i) $problem }}
{{- end }}
{{- fail (printf "\n%s\n" $text) }}
{{- end }}
{{- end }}
