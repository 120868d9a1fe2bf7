{{- define "robotkube.brokerConfiguration" -}}
listener 1883
allow_anonymous false
password_file /run/mosquitto/passwords
acl_file /run/mosquitto/acl
set_tcp_nodelay true
max_inflight_messages {{ .Values.broker.limits.inflightMessages | int64 }}
max_queued_messages {{ .Values.broker.limits.queuedMessages | int64 }}
max_queued_bytes {{ .Values.broker.limits.queuedBytes | int64 }}
message_size_limit {{ .Values.broker.limits.messageBytes | int64 }}
queue_qos0_messages false
# Nothing is written to disk: bridges resend what was not acknowledged and publish retained messages again when they reconnect.
persistence false
sys_interval 0
connection_messages false
log_dest stdout
log_type error
log_type warning
log_type notice
{{- end }}

{{- /* Without a matching line everything is refused. */ -}}
{{- define "robotkube.brokerRules" -}}
user observer
topic read mqtt/#
topic read robotkube/types/mqtt/#
topic read mqtt_client/ros_msg_type/mqtt/#
{{- range .Values.agents }}

user {{ .name }}
{{- if has .role (list "vehicle" "roadside") }}
{{- $own := printf "mqtt/vehicles/%s/#" (include "robotkube.ros" .name) }}
topic readwrite {{ $own }}
topic readwrite robotkube/types/{{ $own }}
topic readwrite mqtt_client/ros_msg_type/{{ $own }}
{{- else }}
topic read mqtt/#
topic read robotkube/types/mqtt/#
topic read mqtt_client/ros_msg_type/mqtt/#
{{- end }}
topic write robotkube/tasks/{{ .name }}
topic read robotkube/task_status/{{ .name }}
topic write robotkube/holds/{{ .name }}
{{- end }}
{{- range $manager := fromYamlArray (include "robotkube.managers" .) }}

user {{ .name }}
{{- range (has "*" .scope.agents) | ternary (list "#") .scope.agents }}
topic read robotkube/tasks/{{ . }}
topic write robotkube/task_status/{{ . }}
topic read robotkube/holds/{{ . }}
{{- end }}
{{- end }}
{{- end }}

{{- define "robotkube.brokerPasswords" -}}
observer:{{ include "robotkube.password" (dict "root" . "purpose" "broker" "account" "observer") }}
{{- range .Values.agents }}
{{ .name }}:{{ include "robotkube.password" (dict "root" $ "purpose" "broker" "account" .name) }}
{{- end }}
{{- range splitList " " (include "robotkube.managerNames" .) }}
{{ . }}:{{ include "robotkube.password" (dict "root" $ "purpose" "broker" "account" .) }}
{{- end }}
{{- end }}
