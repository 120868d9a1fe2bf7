"""Makers: what makes the pods that are strangers, and so may make them again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

REPLICA_SET, DEPLOYMENT, POD = "ReplicaSet", "Deployment", "Pod"
HASH_LABEL = "pod-template-hash"


@dataclass(frozen=True, order=True)
class Maker:
    """What makes a stranger: the workload that a pod is of, or the pod itself when it is of none."""

    namespace: str
    kind: str
    name: str

    def __str__(self) -> str:
        return f"{self.kind} {self.namespace}/{self.name}"


def maker_of(pod: Mapping[str, Any]) -> Maker:
    """The workload of a pod: of a ReplicaSet's the Deployment, which its name begins with."""
    metadata = pod["metadata"]
    namespace = str(metadata["namespace"])
    owner = next((one for one in metadata.get("ownerReferences") or () if one.get("controller")), None)
    if owner is None:
        return Maker(namespace, POD, str(metadata["name"]))
    kind, name = str(owner["kind"]), str(owner["name"])
    suffix = "-" + str((metadata.get("labels") or {}).get(HASH_LABEL, ""))
    if kind == REPLICA_SET and len(suffix) > 1 and name.endswith(suffix):
        return Maker(namespace, DEPLOYMENT, name.removesuffix(suffix))
    return Maker(namespace, kind, name)
