"""Inspections, pods and Deployments as the remover reads them."""

from __future__ import annotations

import copy
from typing import Any

from robotkube.delivery.removal.core.targets import WorkloadTarget
from robotkube.foundation.documents.core.times import time_text

Object = dict[str, Any]
NOW_NS = 1_800_000_000 * 10**9
SEEN_NS = NOW_NS - 5 * 10**9
UID = "uid-1"


def stranger(kind: str = "Pod", name: str = "foreign", namespace: str = "vehicle-00", **more: Any) -> Object:
    words = {"reason": "NoRelease", "message": "it is a stranger", "uid": UID, "since": time_text(SEEN_NS)}
    return {"kind": kind, "namespace": namespace, "name": name, **words, **more}


def inspection(
    *strangers: Object, name: str = "kubelet.one", looks_at: str = "kubelet", seen: str = "True", at_ns: int = SEEN_NS
) -> Object:
    condition = {"type": "Seen", "status": seen, "reason": "Looked", "message": "looked"}
    return {
        "apiVersion": "robotkube.io/v1alpha1",
        "kind": "Inspection",
        "metadata": {"name": name, "namespace": "robotkube", "uid": f"uid-of-{name}"},
        "spec": {"looksAt": looks_at},
        "status": {"observedTime": time_text(at_ns), "strangers": list(strangers), "conditions": [condition]},
    }


def pod(name: str = "foreign", uid: str = UID, owner: str = "", **metadata: Any) -> Object:
    """`owner`: name of the Deployment that it is of; empty: of none."""
    own: Object = {"name": name, "namespace": "vehicle-00", "uid": uid, "resourceVersion": "7", **metadata}
    if owner:
        own["labels"] = {"pod-template-hash": "abc12"}
        own["ownerReferences"] = [{"kind": "ReplicaSet", "name": f"{owner}-abc12", "controller": True}]
    return {"metadata": own, "spec": {"containers": [{"name": "main"}]}}


_DEPLOYMENT: Object = {
    "metadata": {
        "name": "detector",
        "namespace": "vehicle-00",
        "uid": UID,
        "generation": 3,
        "resourceVersion": "7",
        "annotations": {"note": "mine", "deployment.kubernetes.io/revision": "1", "example.com/a~b": "mine"},
        "labels": {"app": "detector"},
    },
    "spec": {
        "replicas": 1,
        "template": {
            "metadata": {"annotations": {"note": "mine"}},
            "spec": {
                "containers": [
                    {"name": "main", "image": "a", "env": [{"name": "A"}, {"name": "B"}, {"name": "C"}]},
                    {"name": "side", "image": "b"},
                    {"name": "other", "image": "c"},
                ],
                "volumes": [{"name": "settings"}, {"name": "extra"}],
            },
        },
    },
}


def deployment() -> Object:
    return copy.deepcopy(_DEPLOYMENT)


def workload_target(*excess: str, uid: str = UID, generation: int = 3) -> WorkloadTarget:
    return WorkloadTarget("vehicle-00", "detector", uid, generation, excess)
