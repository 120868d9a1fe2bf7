{{- define "robotkube.brokerConfiguration" -}}
allow_anonymous false
{{- if include "robotkube.encrypted" . }}
listener 8883
certfile /etc/mosquitto-tls/tls.crt
keyfile /etc/mosquitto-tls/tls.key
{{- if include "robotkube.accountsCertified" . }}
# The account is the common name of the client's certificate; passwords are not looked at.
cafile /etc/mosquitto-accounts/ca.crt
crlfile /etc/mosquitto-accounts/revoked.crl
require_certificate true
use_identity_as_username true
{{- end }}
{{- end }}
{{- if include "robotkube.plain" . }}
# In clear text, by a value that asks for it.
listener 1883
{{- end }}
# Accounts and rights: begun by the pod's init container, then kept by the process `rights`, as main has them.
plugin {{ .Values.broker.plugin | default "mosquitto_dynamic_security.so" }}
plugin_opt_config_file /run/mosquitto/dynamic-security.json
set_tcp_nodelay true
max_inflight_messages {{ .Values.broker.limits.inflightMessages | int64 }}
max_queued_messages {{ .Values.broker.limits.queuedMessages | int64 }}
max_queued_bytes {{ .Values.broker.limits.queuedBytes | int64 }}
message_size_limit {{ .Values.broker.limits.messageBytes | int64 }}
queue_qos0_messages false
# No message is written to disk: bridges resend what was not acknowledged and publish retained messages again when they reconnect.
persistence false
sys_interval 0
# Client ids are secret, and notices name them: whose queue is full, who is disconnected and why.
connection_messages false
log_dest stdout
log_type error
log_type warning
{{- end }}

{{- define "robotkube.brokerPasswords" -}}
observer:{{ include "robotkube.password" (dict "root" . "purpose" "broker" "account" "observer") }}
rights:{{ include "robotkube.password" (dict "root" . "purpose" "broker" "account" "rights") }}
{{- range .Values.agents }}
{{ .name }}:{{ include "robotkube.agentBrokerPassword" (dict "root" $ "agent" .) }}
{{- end }}
{{- range splitList " " (include "robotkube.managerNames" .) }}
{{ . }}:{{ include "robotkube.password" (dict "root" $ "purpose" "broker" "account" .) }}
{{- end }}
{{- end }}
