{{- /* Where suites run: namespaces of a fixed pool, on the node of one agent. Argument: number of the test namespace. */ -}}
{{- define "robotkube.testNamespace" -}}
robotkube-suite-{{ . }}
{{- end }}

{{- /* What the pods of one test namespace may request together, as JSON: suites.testNamespace, what the former key suites.room
       has, and the defaults. These stand here (and in the schema, for readers), since values.yaml could not be told from what
       somebody wrote: what is written under both names is refused (_refusals.tpl). */ -}}
{{- define "robotkube.testNamespaceLimits" -}}
{{- toJson (merge dict (.Values.suites.testNamespace | default dict) (.Values.suites.room | default dict) (dict "cpu" "1" "memory" "4Gi")) }}
{{- end }}

{{- /* The kind of database that suites start: the platform's own. Beside one of others it is the one whose image is given, where it may
       run; empty when there is none. */ -}}
{{- define "robotkube.suitesDatabase" -}}
{{- $mongo := .Values.images.mongo | default "" }}
{{- if ne .Values.database.kind "external" }}{{ .Values.database.kind }}
{{- else if .Values.images.ferretdb }}ferretdb
{{- else if and $mongo (or (not .Values.admission.enabled) (contains "@sha256:" $mongo)) }}mongo{{ end -}}
{{- end }}

{{- /* The agent on whose node suites run: the named one, else the first of role cloud; empty when there is none. */ -}}
{{- define "robotkube.suitesAgent" -}}
{{- $found := .Values.suites.agent }}
{{- range .Values.agents }}{{ if and (not $found) (eq (.role | default "") "cloud") }}{{ $found = .name }}{{ end }}{{ end -}}
{{- $found -}}
{{- end }}
