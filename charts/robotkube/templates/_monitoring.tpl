{{- /* An alerting rule in Prometheus' form. Arguments: {root, alert}, this an entry of files/monitoring/alerts.yaml. */ -}}
{{- define "robotkube.alert" -}}
{{- $left := div (mul (int .root.Values.tls.hours) 3600) 4 | toString -}}
alert: {{ .alert.alert }}
expr: {{ replace "CERTIFICATE_SECONDS_LEFT" $left .alert.expr | toRawJson }}
{{- with int .alert.seconds }}
for: {{ . }}s
{{- end }}
labels: {severity: {{ .alert.severity }}}
annotations:
  summary: {{ toRawJson .alert.summary }}
  description: {{ toRawJson .alert.description }}
{{- end }}

{{- /* A dashboard in Grafana's form, three panels in a row. Arguments: {name, dashboard}, these an entry of files/monitoring/dashboards.yaml. */ -}}
{{- define "robotkube.dashboard" -}}
{{- $source := dict "type" "prometheus" "uid" "${datasource}" }}
{{- $panels := list }}
{{- range $i, $panel := .dashboard.panels }}
{{- $targets := list }}
{{- range $n, $query := $panel.queries }}
{{- $targets = append $targets (dict "datasource" $source "refId" (printf "Q%d" $n) "expr" (index $query 0) "legendFormat" (index $query 1)) }}
{{- end }}
{{- $place := dict "x" (mul 8 (mod $i 3)) "y" (mul 8 (div $i 3)) "w" 8 "h" 8 }}
{{- $field := dict "defaults" (dict "unit" $panel.unit) "overrides" list }}
{{- $panels = append $panels (dict "id" (add1 $i) "type" $panel.kind "title" $panel.title "datasource" $source "gridPos" $place "fieldConfig" $field "targets" $targets) }}
{{- end }}
{{- $choice := dict "name" "datasource" "label" "Data source" "type" "datasource" "query" "prometheus" }}
{{- dict
      "uid" (printf "robotkube-%s" .name) "title" .dashboard.title "tags" (list "robotkube") "schemaVersion" 39 "version" 1 "editable" false
      "refresh" "30s" "time" (dict "from" "now-1h" "to" "now") "templating" (dict "list" (list $choice)) "panels" $panels
    | toPrettyJson }}
{{- end }}
