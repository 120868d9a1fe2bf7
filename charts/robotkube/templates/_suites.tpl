{{- /* Where suites run: namespaces of a fixed pool, on the node of one agent. Argument: number of the test namespace. */ -}}
{{- define "robotkube.testNamespace" -}}
robotkube-suite-{{ . }}
{{- end }}

{{- /* What the pods of one test namespace may request together, as JSON: suites.testNamespace, and over it what the former key
       suites.room has. */ -}}
{{- define "robotkube.testNamespaceLimits" -}}
{{- toJson (merge dict (.Values.suites.room | default dict) (.Values.suites.testNamespace | default dict)) }}
{{- end }}

{{- /* The agent on whose node suites run: the named one, else the first of role cloud; empty when there is none. */ -}}
{{- define "robotkube.suitesAgent" -}}
{{- $found := .Values.suites.agent }}
{{- range .Values.agents }}{{ if and (not $found) (eq .role "cloud") }}{{ $found = .name }}{{ end }}{{ end -}}
{{- $found -}}
{{- end }}
