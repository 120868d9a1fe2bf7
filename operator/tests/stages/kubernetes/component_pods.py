"""Workloads of components and their pods, as far as it is told from them whether they are ready."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.cli.live.component_lines import NAME, PART, POD
from robotkube.cli.live.rollouts import DEPLOYMENT, JOB, STATEFUL_SET

STATES: Mapping[str, Mapping[bool, Mapping[str, Any]]] = {
    DEPLOYMENT: {
        False: {"observedGeneration": 1, "replicas": 1, "updatedReplicas": 1},
        True: {
            "observedGeneration": 1,
            **dict.fromkeys(("replicas", "updatedReplicas", "readyReplicas", "availableReplicas"), 1),
        },
    },
    STATEFUL_SET: {
        False: {"observedGeneration": 1, "replicas": 1, "currentRevision": "a", "updateRevision": "a"},
        True: {
            "observedGeneration": 1,
            **{"replicas": 1, "readyReplicas": 1, "currentRevision": "a", "updateRevision": "a"},
        },
    },
    JOB: {False: {"active": 1}, True: {"succeeded": 1, "conditions": [{"type": "Complete", "status": "True"}]}},
}


def workload(
    name: str, ready: bool = False, kind: str = DEPLOYMENT, namespace: str = "robotkube", part: str = "robotkube"
) -> dict[str, Any]:
    """One with a single pod."""
    metadata = {"namespace": namespace, "name": name, "generation": 1, "labels": {NAME: name, PART: part}}
    return {"kind": kind, "metadata": metadata, "spec": {"replicas": 1}, "status": dict(STATES[kind][ready])}


def pod(name: str, ready: bool = False, phase: str = "Running", namespace: str = "robotkube", **status: Any) -> Any:
    """One whose component is the name without its last part."""
    labels = {NAME: name.rpartition("-")[0]}
    conditions = [{"type": "Ready", "status": str(ready), "message": "" if ready else "containers with unready status"}]
    return {
        "kind": POD,
        "metadata": {"namespace": namespace, "name": name, "labels": labels},
        "status": {"phase": phase, "conditions": conditions, **status},
    }
