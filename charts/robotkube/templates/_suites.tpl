{{- /* Where suites run: namespaces of a fixed pool, on the node of one agent. Argument: number of the room. */ -}}
{{- define "robotkube.room" -}}
robotkube-suite-{{ . }}
{{- end }}

{{- /* The agent on whose node suites run: the named one, else the first of role cloud; empty when there is none. */ -}}
{{- define "robotkube.suitesAgent" -}}
{{- $found := .Values.suites.agent }}
{{- range .Values.agents }}{{ if and (not $found) (eq .role "cloud") }}{{ $found = .name }}{{ end }}{{ end -}}
{{- $found -}}
{{- end }}
