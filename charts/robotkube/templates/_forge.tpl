{{- /* Accounts besides the administrator; what each may do: docs/reference/settings.md. */ -}}
{{- define "robotkube.forgeAccounts" -}}
{{ include "robotkube.managerNames" . }} gate argocd publisher image-publisher suite-runner inspector nodes {{ if (include "robotkube.rights" . | fromJson).enabled }}rights {{ end }}{{ if .Values.admission.enabled }}admission {{ end }}{{ with include "robotkube.viewers" . }}{{ . }} {{ end }}{{ include "robotkube.people" . }}
{{- end }}

{{- /* Accounts of people, separated by blanks; the first ones of the values when an upgrade reuses older values. */ -}}
{{- define "robotkube.people" -}}
{{ join " " (.Values.forge.people | default (list "operator-team" "reviewer")) }}
{{- end }}

{{- /* Accounts that see pull requests and nothing else, separated by blanks. */ -}}
{{- define "robotkube.viewers" -}}
{{ join " " (.Values.forge.viewers | default list) }}
{{- end }}

{{- /* What is wrong with either, one line each. */ -}}
{{- define "robotkube.peopleRefusals" -}}
{{- $people := splitList " " (include "robotkube.people" .) }}
{{- $taken := splitList " " (include "robotkube.platformNames" .) }}
{{- if lt (len (uniq $people)) 2 }}
{{ print "forge.people: nobody may approve what he proposed himself, so with fewer than two accounts nothing that people propose could be merged. Name two or more, each once." }}
{{- end }}
{{- range $key, $names := dict "people" $people "viewers" (.Values.forge.viewers | default list) }}
{{- range $name := $names }}
{{- if not (regexMatch "^[a-z]([-a-z0-9]{0,28}[a-z0-9])?$" $name) }}
{{ printf "forge.%s: %q becomes an account and a Secret. Use at most 30 lower case letters, digits and hyphens, a letter first." $key $name }}
{{- end }}
{{- if has $name $taken }}
{{ printf "forge.%s: %q belongs to a part of the platform. Use another name." $key $name }}
{{- end }}
{{- end }}
{{- end }}
{{- range .Values.forge.viewers }}
{{- if has . $people }}
{{ printf "forge.viewers: %q is one of forge.people, who may write. Name it in one of the two." . }}
{{- end }}
{{- end }}
{{- end }}

{{- /* Names that neither a manager, nor a person, nor a viewer may have. */ -}}
{{- define "robotkube.platformNames" -}}
administrator admission argocd bootstrap broker certificates console database default forge gate gate-key image-publisher inspector nodes observer own-images publisher remover rights robotkube staging staging-publisher suite-runner teardown verified
{{- end }}

{{- /* Who hears from the forge. Each has a secret of its own, so that none can speak to another in the forge's name. */ -}}
{{- define "robotkube.hearers" -}}
gate {{ include "robotkube.managerNames" . }}{{ if (include "robotkube.rights" . | fromJson).enabled }} rights{{ end }}{{ if .Values.admission.enabled }} admission{{ end }}
{{- end }}

{{- /* app.ini. A Secret, since it holds keys. The file is read-only for the forge, so every key it would write there itself is given. */ -}}
{{- define "robotkube.forgeIni" -}}
APP_NAME = RobotKube
WORK_PATH = /data
[server]
HTTP_ADDR = 0.0.0.0
HTTP_PORT = 3000
{{- if include "robotkube.forgeEncrypted" . }}
PROTOCOL = https
CERT_FILE = /etc/forge-tls/tls.crt
KEY_FILE = /etc/forge-tls/tls.key
{{- end }}
ROOT_URL = {{ include "robotkube.forgeUrl" . }}/
LOCAL_ROOT_URL = {{ include "robotkube.forgeEncrypted" . | eq "true" | ternary "https" "http" }}://127.0.0.1:3000/
{{- with .Values.forge.staticRootPath }}
STATIC_ROOT_PATH = {{ . }}
{{- end }}
APP_DATA_PATH = /data/data
DISABLE_SSH = true
OFFLINE_MODE = true
LFS_START_SERVER = false
[database]
DB_TYPE = sqlite3
PATH = /data/gitea.db
SQLITE_JOURNAL_MODE = WAL
[security]
INSTALL_LOCK = true
SECRET_KEY = {{ include "robotkube.password" (dict "root" . "purpose" "forge-key" "account" "secret") }}
INTERNAL_TOKEN = {{ include "robotkube.password" (dict "root" . "purpose" "forge-key" "account" "internal") }}
# Passwords here are 240 random bits: no one guesses them from a hash, and each Git and registry request is checked against one.
PASSWORD_HASH_ALGO = pbkdf2$1000$50
[oauth2]
{{- if include "robotkube.consoleForge" . }}
# For the console, which asks who somebody is and nothing else: the ID token says so. No other token counts for a moment, whoever
# registers a client, since Git and Basic authentication take one for whatever the person may, also where its scopes are less.
# The key that signs is made by the forge, and stays on its volume: jwt/private.pem.
ENABLED = true
JWT_SIGNING_ALGORITHM = ES256
ACCESS_TOKEN_EXPIRATION_TIME = 0
REFRESH_TOKEN_EXPIRATION_TIME = 0
DEFAULT_APPLICATIONS =
{{- else }}
ENABLED = false
{{- end }}
JWT_SECRET = {{ include "robotkube.password" (dict "root" . "purpose" "forge-key" "account" "jwt") | trunc 32 | b64enc | trimSuffix "=" }}
{{ .Files.Get "files/forge-rights.ini" | required "files/forge-rights.ini is not in the chart" | trim }}
[repository]
ROOT = /data/repositories
# Hooks start with every push, several at once: sh starts faster than bash.
SCRIPT_TYPE = sh
DEFAULT_BRANCH = main
[packages]
ENABLED = true
[actions]
ENABLED = false
[mailer]
ENABLED = false
[cron]
ENABLED = false
[log]
MODE = console
LEVEL = Warn
[indexer]
ISSUE_INDEXER_TYPE = db
[session]
PROVIDER = memory
[cache]
ADAPTER = memory
[queue]
TYPE = channel
[git.config]
# The forge's own hooks in fewer processes; and no upkeep of the temporary repositories in which proposals are tried.
core.hooksPath = /etc/forge-hooks
maintenance.auto = false
[webhook]
# Manager and gate have private addresses, which Gitea refuses by itself.
ALLOWED_HOST_LIST = private
{{- end }}

{{- /* The administrator, made or given its password again; run by the same program and files as the forge. */ -}}
{{- define "robotkube.forgePrepare" -}}
set -eu
forge() { gitea --config /etc/gitea/app.ini "$@"; }
account() { cat "/var/run/secrets/robotkube/$1"; }
forge migrate
if forge admin user list --admin | grep -qw "$(account username)"; then
  forge admin user change-password --username "$(account username)" --password "$(account password)" --must-change-password=false
else
  forge admin user create --admin --username "$(account username)" --password "$(account password)" \
    --email administrator@forge.invalid --must-change-password=false
fi
{{- end }}
