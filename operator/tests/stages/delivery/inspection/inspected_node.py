"""Pods, workloads and what may run, as examples of the inspection."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from robotkube.delivery.inspection.core.kubelet_pods import KubeletPod, RuntimePod, read_pods, read_runtime_pods
from robotkube.delivery.inspection.core.permitted import Permitted, ReleaseShape
from robotkube.registry.admission.core.allowed import Allowed
from robotkube.registry.admission.core.domain import Domain

VERIFIED, OF_PLATFORM, FOREIGN = (f"sha256:{digit * 64}" for digit in "abf")
CHART = f"detector@sha256:{'c' * 64}"
IMAGE = f"forge.example/robotkube/ros@{VERIFIED}"
PLATFORM_IMAGE = f"forge.example/robotkube/platform@{OF_PLATFORM}"
FOREIGN_IMAGE = f"elsewhere.example/x@{FOREIGN}"
DOMAIN = Domain(("vehicle-00", "cloud-0"), ("robotkube-suite-0",), "oci://forge.example/verified")
NOW = 1_000_000.0

RENDERED: Mapping[str, Any] = {
    "apiVersion": "apps/v1",
    "kind": "Deployment",
    "metadata": {"name": "detector", "labels": {"app.kubernetes.io/instance": "detector"}},
    "spec": {
        "replicas": 1,
        "strategy": {"type": "Recreate"},
        "selector": {"matchLabels": {"app.kubernetes.io/instance": "detector"}},
        "template": {
            "metadata": {"labels": {"app.kubernetes.io/instance": "detector"}},
            "spec": {
                "serviceAccountName": "application",
                "containers": [
                    {
                        "name": "detector",
                        "image": IMAGE,
                        "command": ["robotkube-event-detector"],
                        "resources": {"requests": {"cpu": "1000m", "memory": "64Mi"}},
                        "env": [{"name": "NODE_NAME", "valueFrom": {"fieldRef": {"fieldPath": "spec.nodeName"}}}],
                        "livenessProbe": {"httpGet": {"path": "/livez", "port": "health"}},
                    }
                ],
                "volumes": [{"name": "settings", "configMap": {"name": "detector"}}],
            },
        },
    },
}


def permitted(elsewhere: bool = False, **changes: Any) -> Permitted:
    """The detector of vehicle-00 may run, the platform's image, and images in test namespaces."""
    domain = Domain(DOMAIN.agents, DOMAIN.tests, DOMAIN.charts, elsewhere=elsewhere)
    release = ReleaseShape("detector", CHART, {"detector": RENDERED})
    given = {
        "allowed": Allowed((VERIFIED,), (OF_PLATFORM,), (CHART,)),
        "releases": {"vehicle-00": [release]},
        **changes,
    }
    return Permitted(domain, **given)


def deployment() -> dict[str, Any]:
    """The detector's Deployment as the API server has it."""
    item = copy.deepcopy(dict(RENDERED))
    item["metadata"] |= {
        "namespace": "vehicle-00",
        "uid": "1",
        "resourceVersion": "7",
        "generation": 1,
        "annotations": {"deployment.kubernetes.io/revision": "1", "argocd.argoproj.io/tracking-id": "x"},
        "managedFields": [{"manager": "argocd-controller"}],
    }
    item["spec"] |= {"progressDeadlineSeconds": 600, "revisionHistoryLimit": 10}
    item["spec"]["template"]["metadata"]["creationTimestamp"] = None
    pod = item["spec"]["template"]["spec"]
    pod |= {
        "restartPolicy": "Always",
        "dnsPolicy": "ClusterFirst",
        "schedulerName": "default-scheduler",
        "securityContext": {},
        "terminationGracePeriodSeconds": 30,
        "serviceAccount": "application",
    }
    pod["volumes"][0]["configMap"]["defaultMode"] = 420
    container = pod["containers"][0]
    container |= {
        "imagePullPolicy": "IfNotPresent",
        "terminationMessagePath": "/dev/termination-log",
        "terminationMessagePolicy": "File",
    }
    container["resources"]["requests"]["cpu"] = "1"
    container["env"][0]["valueFrom"]["fieldRef"]["apiVersion"] = "v1"
    container["livenessProbe"] |= {"timeoutSeconds": 1, "periodSeconds": 10, "successThreshold": 1}
    container["livenessProbe"]["failureThreshold"] = 3
    container["livenessProbe"]["httpGet"]["scheme"] = "HTTP"
    item["status"] = {"readyReplicas": 1}
    return item


def pod_object(namespace: str = "vehicle-00", **changes: Any) -> dict[str, Any]:
    """A pod of the detector as its kubelet lists it. `changes` replace the name, owner (kind and name), annotations,
    image, phase or other parts of it."""
    kind, owner = changes.pop("owner", ("ReplicaSet", "detector-5d9c7b"))
    spec = copy.deepcopy(deployment()["spec"]["template"]["spec"])
    spec |= {"nodeName": "vehicle-00-a", "enableServiceLinks": True, **changes.pop("spec", {})}
    spec["containers"][0]["image"] = changes.pop("image", IMAGE)
    metadata = {
        "name": changes.pop("name", "detector-5d9c7b-x"),
        "namespace": namespace,
        "uid": changes.pop("uid", "u1"),
        "labels": {"app.kubernetes.io/instance": "detector", "pod-template-hash": "5d9c7b"},
        "annotations": {"kubernetes.io/config.source": "api", **changes.pop("annotations", {})},
    }
    if kind:
        metadata["ownerReferences"] = [{"kind": kind, "name": owner, "controller": True}]
    status = {"phase": "Running", **changes.pop("status", {})}
    return {"metadata": metadata | changes.pop("metadata", {}), "spec": spec, "status": status}


def pods(*objects: Mapping[str, Any]) -> tuple[KubeletPod, ...]:
    """As a kubelet's list says them."""
    return read_pods({"items": objects}, True)


def running(*objects: tuple[str, str, Mapping[str, str]]) -> tuple[RuntimePod, ...]:
    """What the runtime has: uid, name and container -> image of each pod."""
    return read_runtime_pods(
        {
            "items": [
                {
                    "metadata": {"uid": uid, "namespace": "vehicle-00", "name": name},
                    "spec": {"containers": [{"name": key, "image": image} for key, image in containers.items()]},
                }
                for uid, name, containers in objects
            ]
        }
    )
