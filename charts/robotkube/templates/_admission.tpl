{{- /* Admission policies, as the code makes them (files/admission/policies.json, by `make reference`), with this installation's names. */ -}}
{{- define "robotkube.admissionPolicies" -}}
{{- $agents := list }}{{ range .Values.agents }}{{ $agents = append $agents .name }}{{ end }}
{{- $tests := list }}
{{- if .Values.suites.enabled }}{{ range $i := until (int .Values.suites.pool) }}{{ $tests = append $tests (include "robotkube.testNamespace" $i) }}{{ end }}{{ end }}
{{- $text := .Files.Get "files/admission/policies.json" }}
{{- range $placeholder, $names := dict "placeholder-agent" $agents "placeholder-test" $tests }}
{{- $quoted := list }}{{ $literal := list }}
{{- range $names }}{{ $quoted = append $quoted (quote .) }}{{ $literal = append $literal (squote .) }}{{ end }}
{{- $text = $text | replace (quote $placeholder) (join ", " $quoted) | replace (squote $placeholder) (join "," $literal) }}
{{- end }}
{{- $text = $text | replace "placeholder-platform" .Release.Namespace | replace "placeholder-gate" (include "robotkube.gateNamespace" .) | replace "placeholder-argocd" .Values.argocd.namespace }}
{{- $text = $text | replace "oci://placeholder.example/verified" (include "robotkube.charts" .) }}
{{- $without := list }}
{{- if not $agents }}{{ $without = append $without "robotkube-agents" }}{{ end }}
{{- if not $tests }}{{ $without = append $without "robotkube-tests" }}{{ end }}
{{- $labels := include "robotkube.labels" (dict "root" . "component" "admission") | fromYaml }}
{{- range ($text | fromJson).items }}{{ if not (has .metadata.name $without) }}
{{- $_ := set .metadata "labels" $labels }}
---
{{ toYaml . }}
{{- end }}{{ end }}
{{- end }}

{{- /* Digests of the platform's images, as keys. */ -}}
{{- define "robotkube.platformDigests" -}}
{{- range .Values.images }}{{ if contains "@sha256:" . }}
platform.{{ regexFind "@sha256:[0-9a-f]+" . | trimPrefix "@sha256:" }}: ""
{{- end }}{{ end }}
{{- end }}
