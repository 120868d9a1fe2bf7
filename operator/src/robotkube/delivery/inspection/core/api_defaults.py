"""What the API server fills in where a manifest is silent (Kubernetes 1.36, pkg/apis/{core,apps}/v1/defaults.go).

A place is the path of keys from the object, `*` for every entry of a list. A field that the manifest does not name and
that has exactly the value below was not written by anybody.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

POD = "spec.template.spec"
OF_WORKLOADS: Mapping[str, Any] = {
    "spec.progressDeadlineSeconds": 600,
    "spec.revisionHistoryLimit": 10,
    "spec.strategy": {"type": "RollingUpdate", "rollingUpdate": {"maxSurge": "25%", "maxUnavailable": "25%"}},
    "spec.strategy.type": "RollingUpdate",
    "spec.strategy.rollingUpdate": {"maxSurge": "25%", "maxUnavailable": "25%"},
    "spec.strategy.rollingUpdate.maxSurge": "25%",
    "spec.strategy.rollingUpdate.maxUnavailable": "25%",
}
OF_PODS: Mapping[str, Any] = {
    "restartPolicy": "Always",
    "dnsPolicy": "ClusterFirst",
    "schedulerName": "default-scheduler",
    "securityContext": {},
    "terminationGracePeriodSeconds": 30,
    "enableServiceLinks": True,
    "volumes.*.emptyDir": {},
    "volumes.*.configMap.defaultMode": 420,
    "volumes.*.secret.defaultMode": 420,
    "volumes.*.projected.defaultMode": 420,
    "volumes.*.downwardAPI.defaultMode": 420,
    "volumes.*.hostPath.type": "",
    "volumes.*.projected.sources.*.serviceAccountToken.expirationSeconds": 3600,
    "volumes.*.projected.sources.*.downwardAPI.items.*.fieldRef.apiVersion": "v1",
    "volumes.*.downwardAPI.items.*.fieldRef.apiVersion": "v1",
    "topologySpreadConstraints.*.nodeAffinityPolicy": "Honor",
    "topologySpreadConstraints.*.nodeTaintsPolicy": "Ignore",
}
OF_PROBES: Mapping[str, Any] = {
    "timeoutSeconds": 1,
    "periodSeconds": 10,
    "successThreshold": 1,
    "failureThreshold": 3,
    "httpGet.scheme": "HTTP",
    "httpGet.path": "/",
    "grpc.service": "",
}
OF_CONTAINERS: Mapping[str, Any] = {
    "imagePullPolicy": "IfNotPresent",  # of an image by digest, or by a tag that is not `latest`
    "terminationMessagePath": "/dev/termination-log",
    "terminationMessagePolicy": "File",
    "resources": {},
    "ports.*.protocol": "TCP",
    "env.*.valueFrom.fieldRef.apiVersion": "v1",
    "env.*.valueFrom.resourceFieldRef.divisor": "0",
    "lifecycle.postStart.httpGet.scheme": "HTTP",
    "lifecycle.preStop.httpGet.scheme": "HTTP",
    "securityContext.procMount": "Default",
    **{
        f"{probe}.{key}": value
        for probe in ("livenessProbe", "readinessProbe", "startupProbe")
        for key, value in OF_PROBES.items()
    },
}
CONTAINERS = ("containers", "initContainers")


def _all() -> dict[str, Any]:
    in_pods = {
        **OF_PODS,
        **{f"{kind}.*.{key}": value for kind in CONTAINERS for key, value in OF_CONTAINERS.items()},
    }
    return {**OF_WORKLOADS, **{f"{POD}.{key}": value for key, value in in_pods.items()}}


DEFAULTS: Mapping[str, Any] = _all()
"""Place in a Deployment -> what stands there when the manifest says nothing."""
