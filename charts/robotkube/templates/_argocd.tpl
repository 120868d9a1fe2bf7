{{- /* How managers reach argocd-server: {url, authorities}. JSON. */ -}}
{{- define "robotkube.argocdServer" -}}
{{- $server := .Values.argocd.server | default dict }}
{{- $authorities := $server.authorities | default "" }}
{{- $service := include "robotkube.host" (dict "root" . "name" "argocd-server" "namespace" .Values.argocd.namespace) }}
{{- toJson (dict "authorities" $authorities "url" ($server.url | default (printf "%s://%s" (ternary "https" "http" (ne $authorities "")) $service))) }}
{{- end }}

{{- /* What is wrong with these values, a line each. */ -}}
{{- define "robotkube.argocdRefusals" -}}
{{- $server := include "robotkube.argocdServer" . | fromJson }}
{{- if contains "PRIVATE KEY" $server.authorities }}
{{ print "argocd.server.authorities: holds a private key; it would stand in a ConfigMap. Give the certificate alone, and argocd-server another key from now on." }}
{{- else if and $server.authorities (not (regexMatch "^\\s*-----BEGIN CERTIFICATE-----\\s" $server.authorities)) }}
{{ print "argocd.server.authorities: must be PEM that begins with -----BEGIN CERTIFICATE-----; several certificates stand one after the other." }}
{{- end }}
{{- if and $server.authorities (not (hasPrefix "https://" $server.url)) }}
{{ printf "argocd.server.authorities is given, but argocd.server.url is %s, where nobody would ask for a certificate. Begin it with https://, or leave one of them out." $server.url }}
{{- end }}
{{- end }}

{{- /* Installed, and copied into the deployment repository to be read there. */ -}}
{{- define "robotkube.appProject" -}}
apiVersion: argoproj.io/v1alpha1
kind: AppProject
metadata:
  name: robotkube-apps
  namespace: {{ .Values.argocd.namespace }}
  labels: {{- include "robotkube.labels" (dict "root" . "component" "argocd") | nindent 4 }}
spec:
  description: releases of the deployment repository, and nothing else
  sourceRepos: [{{ include "robotkube.charts" . }}/*]          # * crosses no slash
  destinations:
  {{- range .Values.agents }}
  - {server: "https://kubernetes.default.svc", namespace: {{ .name }}}
  {{- else }} []
  {{- end }}
  clusterResourceWhitelist: []
  namespaceResourceWhitelist:
  - {group: apps, kind: Deployment}
  - {group: "", kind: ConfigMap}
{{- end }}

{{- define "robotkube.applicationSet" -}}
apiVersion: argoproj.io/v1alpha1
kind: ApplicationSet
metadata:
  name: releases
  namespace: {{ .Values.argocd.namespace }}
  labels: {{- include "robotkube.labels" (dict "root" . "component" "argocd") | nindent 4 }}
spec:
  goTemplate: true
  goTemplateOptions: ["missingkey=error"]
  generators:
  - git:
      repoURL: {{ include "robotkube.forgeUrl" . }}/robotkube/deployment.git
      revision: main
      requeueAfterSeconds: 300                                 # only the fallback: the gate's hook is the normal way
      files: [{path: "releases/**/*.yaml"}]
  template:
    metadata:
      name: {{ `'{{ .metadata.namespace }}-{{ .metadata.name }}'` }}
      namespace: {{ .Values.argocd.namespace }}
      labels:
        robotkube.io/agent: {{ `'{{ .metadata.namespace }}'` }}
      annotations:
        robotkube.io/plan: {{ `'{{ index .metadata.annotations "robotkube.io/plan" }}'` }}
      finalizers: [resources-finalizer.argocd.argoproj.io]
    spec:
      project: robotkube-apps
      # Git is the history. Ten copies of a source and its values would be written with every change of the status.
      revisionHistoryLimit: 0
      source:
        repoURL: {{ include "robotkube.charts" . | printf "'%s/{{ index .metadata.annotations \"robotkube.io/chart\" }}'" }}
        path: .                                                # required, also for a chart
        # A tag written there by mistake becomes sha256:<tag>, which resolves to nothing.
        targetRevision: {{ `'sha256:{{ index .metadata.annotations "robotkube.io/chart-digest" | trimPrefix "sha256:" }}'` }}
        helm:
          releaseName: {{ `'{{ .metadata.name }}'` }}
          values: {{ `'{{ toJson (dig "values" (dict) .spec) }}'` }}           # a string: nothing is interpreted or dropped
          parameters:
          - {name: global.plan, value: {{ `'{{ index .metadata.annotations "robotkube.io/plan" }}'` }}, forceString: true}
      destination: {server: https://kubernetes.default.svc, namespace: {{ `'{{ .metadata.namespace }}'` }}}
      syncPolicy:
        automated: {prune: true, selfHeal: true}
        # ApplyOutOfSyncOnly and no client-side validation: 40 % less CPU in the controller for a plan of many releases.
        # Applied by the server: a client fetches and reads the API's whole description for each object that it patches.
        syncOptions: [ApplyOutOfSyncOnly=true, ServerSideApply=true, Validate=false]
        retry: {limit: 2, backoff: {duration: 1s, factor: 2, maxDuration: 2s}}       # longer retries hold a corrected release back
{{- end }}
