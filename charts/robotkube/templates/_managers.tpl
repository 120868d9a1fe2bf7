{{- /* The managers with every key: what `managers` leaves out is filled in here, once. A JSON list. */ -}}
{{- define "robotkube.managers" -}}
{{- include "robotkube.once" (dict "root" . "of" "robotkube.managersOfValues") -}}
{{- end }}

{{- define "robotkube.managersOfValues" -}}
{{- $found := list }}
{{- range .Values.managers }}
{{- $scope := .scope | default dict }}
{{- $agents := $scope.agents | default (list "*") }}
{{- $filled := dict "agents" $agents "namespaces" ($scope.namespaces | default $agents) "applications" ($scope.applications | default (list "*")) }}
{{- $manager := dict "name" .name "scope" $filled "operators" (.operators | default list) "replicas" (.replicas | default 1 | int) }}
{{- $manager = merge $manager (pick . "nodeSelector" "tolerations" "affinity" "podAnnotations" "podLabels" "extraEnv" "priorityClassName") }}
{{- $_ := set $manager "nodeLostSeconds" (.nodeLostSeconds | default 40 | int) }}
{{- $_ := set $manager "resources" (.resources | default (dict "requests" (dict "cpu" "50m" "memory" "96Mi") "limits" (dict "memory" "512Mi"))) }}
{{- $found = append $found $manager }}
{{- end }}
{{- toJson $found }}
{{- end }}

{{- define "robotkube.managerNames" -}}
{{- range $i, $manager := fromJsonArray (include "robotkube.managers" .) }}{{ if $i }} {{ end }}{{ $manager.name }}{{ end -}}
{{- end }}

{{- /* The declared agents in a manager's scope, separated by spaces. Arguments: {root, manager}. */ -}}
{{- define "robotkube.managerAgents" -}}
{{- $found := list }}
{{- range .root.Values.agents }}
{{- if or (has "*" $.manager.scope.agents) (has .name $.manager.scope.agents) }}{{ $found = append $found .name }}{{ end }}
{{- end }}
{{- join " " $found -}}
{{- end }}

{{- /* Rights on tasks and pods of namespaces: in a ClusterRole for all namespaces, else in a Role of each. */ -}}
{{- define "robotkube.managerRules" -}}
- apiGroups: [robotkube.io]
  resources: [taskdescriptions]
  verbs: [get, list, watch, create, patch, delete]     # what comes by MQTT becomes a task; a chain that ended goes
- apiGroups: [robotkube.io]
  resources: [taskdescriptions/status]
  verbs: [patch, update]
- apiGroups: [events.k8s.io]
  resources: [events]
  verbs: [create]
- apiGroups: [""]
  resources: [pods]
  verbs: [get, list, watch]
{{- end }}

{{- /* Who moves main, in the first commit of the deployment repository. */ -}}
{{- define "robotkube.mergePolicy" -}}
{{- $lines := list }}
{{- range $manager := fromJsonArray (include "robotkube.managers" .) }}
{{- $paths := list "releases/" "sources/" }}
{{- if not (has "*" $manager.scope.agents) }}
{{- $paths = list }}
{{- range splitList " " (include "robotkube.managerAgents" (dict "root" $ "manager" $manager)) }}
{{- $paths = append (append $paths (printf "releases/%s/" .)) (printf "sources/%s/" .) }}
{{- end }}
{{- end }}
{{- $lines = append $lines (printf "- author: %s\n  paths: [%s]" $manager.name (join ", " $paths)) }}
{{- end }}
{{- regexReplaceAll "(?m)^- author: manager\n  paths: .*$" (.Files.Get "files/deployment/policies/merge.yaml") (join "\n" $lines) }}
{{- end }}

{{- /* What is wrong with each of `managers` by itself, one line each. Whether they fit together is said by the managers and the gate
       when they start (robotkube.delivery.manager.core.placement.scopes). */ -}}
{{- define "robotkube.managerRefusals" -}}
{{- $taken := concat (splitList " " (include "robotkube.platformNames" .)) (splitList " " (include "robotkube.people" .)) (.Values.forge.viewers | default list) }}
{{- $declared := list }}{{ range .Values.agents }}{{ $declared = append $declared .name }}{{ end }}
{{- $managers := fromJsonArray (include "robotkube.managers" .) }}
{{- if .Values.manager }}
{{ print "manager: this value was replaced by the list managers. Move its resources to managers[0].resources (name: manager), and upgrade with --reset-then-reuse-values instead of --reuse-values." }}
{{- end }}
{{- if not $managers }}
{{ print "managers is empty: nobody would answer tasks. Leave the key out for one manager of everything, or declare one." }}
{{- end }}
{{- $names := list }}
{{- range $i, $manager := $managers }}
{{- $at := printf "managers[%d] %q" $i $manager.name }}
{{- if not (regexMatch "^[a-z]([-a-z0-9]{0,28}[a-z0-9])?$" $manager.name) }}
{{ printf "%s: the name becomes that of a Deployment, a Service and an account. Use at most 30 lower case letters, digits and hyphens, a letter first." $at }}
{{- end }}
{{- if has $manager.name $taken }}
{{ printf "%s: this name belongs to a part of the platform. Use another one, such as manager-north." $at }}
{{- end }}
{{- if has $manager.name $declared }}
{{ printf "%s: an agent has this name, and accounts of both would be one. Use another name." $at }}
{{- end }}
{{- if has $manager.name $names }}
{{ printf "%s: declared twice. Give each manager a name of its own." $at }}
{{- end }}
{{- $names = append $names $manager.name }}
{{- range $key := list "agents" "namespaces" "applications" }}
{{- if and (has "*" (index $manager.scope $key)) (gt (len (index $manager.scope $key)) 1) }}
{{ printf "%s: scope.%s names * and others. Leave the others out, or the *." $at $key }}
{{- end }}
{{- end }}
{{- range $name := $manager.scope.agents }}
{{- if and (ne $name "*") (not (has $name $declared)) }}
{{ printf "%s: scope.agents names %q, which is none of agents. Declare it there, or take it out here." $at $name }}
{{- end }}
{{- end }}
{{- range $name := $manager.scope.namespaces }}
{{- if has $name (list $.Release.Namespace (include "robotkube.gateNamespace" $) $.Values.argocd.namespace) }}
{{ printf "%s: scope.namespaces names %q, which belongs to the platform: no task can stand there. Take it out." $at $name }}
{{- end }}
{{- end }}
{{- end }}
{{- end }}
