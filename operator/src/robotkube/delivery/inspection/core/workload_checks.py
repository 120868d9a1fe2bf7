"""Strangers among the workloads of agents' namespaces: what no release has, and what is not as its chart renders it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.delivery.inspection.core.comparison import differences
from robotkube.delivery.inspection.core.kubelet_pods import RELEASE_LABEL
from robotkube.delivery.inspection.core.permitted import CHARTS_KIND, Permitted
from robotkube.delivery.inspection.core.strangers import NO_RELEASE, NOT_OF_THE_CHART, Stranger

Object = Mapping[str, Any]

RESTORE = "Delete it, and Argo CD makes it anew as main says"
REMOVE = "Delete it; what is to run is proposed as a release (robotkube task submit)"


def strangers_among(workload: Object, kind: str, permitted: Permitted) -> Iterator[Stranger]:
    """What is strange about one workload of an agent's namespace; nothing about one that is being deleted."""
    metadata = workload["metadata"]
    if metadata.get("deletionTimestamp") or _made_by(metadata, kind):
        return
    namespace, name = str(metadata["namespace"]), str(metadata["name"])
    release = str((metadata.get("labels") or {}).get(RELEASE_LABEL, ""))
    shape = permitted.release(namespace, release)
    versions = shape.versions(name) if shape and kind == CHARTS_KIND else ()
    place = f"{kind} {namespace}/{name}"
    if shape and shape.unknown and kind == CHARTS_KIND:
        return
    if not versions:
        what = f"release {release} does not have it" if shape else "no release that main of the deployment has"
        yield Stranger(kind, namespace, name, NO_RELEASE, f"{place}: {what}. {REMOVE}")
        return
    problems = [differences(workload, version) for version in versions]
    if () not in problems:
        text = f"{place} is not what the chart of release {release} renders: {'; '.join(problems[0])}. {RESTORE}"
        yield Stranger(kind, namespace, name, NOT_OF_THE_CHART, text)


def _made_by(metadata: Object, kind: str) -> bool:
    """Whether a controller made it of a workload that is looked at itself."""
    owners = {owner.get("kind") for owner in metadata.get("ownerReferences") or () if owner.get("controller")}
    return bool(owners & {"ReplicaSet": {"Deployment"}, "Job": {"CronJob"}}.get(kind, set()))
