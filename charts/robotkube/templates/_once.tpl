{{- /* What the template of this name makes of the whole chart's values, made once per rendering and kept among the values, as the
       seed is: for what many others ask for that is dear to make, or that asks the cluster. Arguments: {root, of}. */ -}}
{{- define "robotkube.once" -}}
{{- $made := .root.Values.made | default dict }}
{{- if not (hasKey $made .of) }}
{{- $_ := set .root.Values "made" (set $made .of (include .of .root)) }}
{{- end }}
{{- get $made .of -}}
{{- end }}
