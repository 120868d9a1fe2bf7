{{- /* The Job's spec. Its pods stand where the gate's do. */ -}}
{{- define "robotkube.gateKeyJob" -}}
backoffLimit: 6
template:
  metadata:
    labels: {{- include "robotkube.podLabels" (dict "root" . "component" "gate-key" "image" (include "robotkube.image" (dict "root" . "name" "platform")) "values" .Values.gate) | nindent 6 }}
    annotations:
      {{- include "robotkube.settingsAnnotation" (dict "root" . "component" "gateKey") | nindent 6 }}
      {{- with .Values.gate.podAnnotations }}
      {{- toYaml . | nindent 6 }}
      {{- end }}
  spec:
    restartPolicy: Never
    serviceAccountName: gate-key
    automountServiceAccountToken: true
    terminationGracePeriodSeconds: 5
    {{- include "robotkube.pod" (dict "root" . "values" .Values.gate) | nindent 4 }}
    containers:
    - name: gate-key
      image: {{ include "robotkube.image" (dict "root" . "name" "platform") }}
      command: [robotkube-gate-key]
      {{- include "robotkube.processEnvironment" . | nindent 6 }}
      {{- with .Values.gate.extraEnv }}
      {{- toYaml . | nindent 6 }}
      {{- end }}
      resources: {requests: {cpu: 50m, memory: 64Mi}, limits: {memory: 256Mi}}
      {{- include "robotkube.container" . | nindent 6 }}
      volumeMounts:
      - {name: settings, mountPath: /etc/robotkube, readOnly: true}
      - {name: former, mountPath: /var/run/secrets/robotkube/former, readOnly: true}
      - {name: tmp, mountPath: /tmp}
    volumes:
    - {name: settings, configMap: {name: gate-key}}
    # The key of an installation from before the gate had a namespace of its own; it moves with the upgrade.
    - {name: former, secret: {secretName: gate-key, optional: true, defaultMode: 0440}}
    - {name: tmp, emptyDir: {sizeLimit: 16Mi}}
{{- end }}
