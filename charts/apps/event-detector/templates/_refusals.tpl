{{- /* What depends on several values and what a detector could only find out when it runs. All problems are said at once. */ -}}
{{- define "event-detector.refusals" -}}
{{- $problems := list -}}
{{- $values := .Values -}}
{{- range $i, $topic := ($values.detector).topics -}}
{{- if and (eq (dig "source" "ros" $topic) "mqtt") (not ($values.broker).existingSecret) -}}
{{- $problems = append $problems (printf "detector.topics[%d] %s: source mqtt needs an account at the broker. Give broker.existingSecret." $i $topic.name) -}}
{{- end -}}
{{- end -}}
{{- range $i, $reaction := ($values.detector).reactions -}}
{{- $at := printf "detector.reactions[%d] of rule %s" $i $reaction.rule -}}
{{- if and (eq $reaction.kind "recording") (not ($values.recordings).claim) -}}
{{- $problems = append $problems (printf "%s: a recording needs a place for its segments. Give recordings.claim." $at) -}}
{{- end -}}
{{- if and (eq $reaction.kind "recording") (not ($values.database).existingSecret) -}}
{{- $problems = append $problems (printf "%s: a recording needs a database for its index. Give database.existingSecret." $at) -}}
{{- end -}}
{{- if and (eq $reaction.kind "mqtt") (not ($values.broker).existingSecret) -}}
{{- $problems = append $problems (printf "%s: kind mqtt needs an account at the broker. Give broker.existingSecret." $at) -}}
{{- end -}}
{{- if and (eq $reaction.kind "webhook") $reaction.secret (not ($values.webhooks).existingSecret) -}}
{{- $problems = append $problems (printf "%s: secret %s is a key of no Secret. Give webhooks.existingSecret." $at $reaction.secret) -}}
{{- end -}}
{{- end -}}
{{- with (($values.detector).buffer).bag -}}
{{- if not ($values.bags).claim -}}
{{- $problems = append $problems (printf "detector.buffer.bag %s: no claim holds it. Give bags.claim, which is mounted at /var/lib/robotkube/bags." .) -}}
{{- end -}}
{{- end -}}
{{- with $problems -}}
{{- $lines := list -}}
{{- range $i, $problem := . -}}
{{- $lines = append $lines (printf "  %d. %s" (add $i 1) $problem) -}}
{{- end -}}
{{ fail (printf "\n\nevent-detector: %d problem(s) in the values, nothing was changed:\n%s\n" (len .) (join "\n" $lines)) }}
{{- end -}}
{{- end }}
