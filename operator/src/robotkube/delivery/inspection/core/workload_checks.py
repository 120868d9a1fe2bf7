"""Strangers among the workloads of agents' namespaces: what no release has, and what is not as its chart renders it,
ConfigMaps of releases among it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from robotkube.delivery.inspection.core.comparison import differences, differing_keys
from robotkube.delivery.inspection.core.excess import excess
from robotkube.delivery.inspection.core.kubelet_pods import RELEASE_LABEL
from robotkube.delivery.inspection.core.permitted import CHARTS_KIND, SETTINGS_KIND, Permitted, place
from robotkube.delivery.inspection.core.strangers import (
    FOREIGN_CHART,
    NO_RELEASE,
    NOT_OF_THE_CHART,
    Stranger,
)

Object = Mapping[str, Any]

RESTORE = "Delete it, and Argo CD makes it anew as main says"
FIND = (
    "Look who changed it: it, the ApplicationSet of releases, or what Argo CD ignores (argocd-cm). Then delete it, and "
    "Argo CD makes it anew as main says"
)
BEFORE = (
    "; main had it so before, and Argo CD has had 15 min to put today's there: look first whether it runs and can "
    "apply the release"
)
WITHDRAW = "Submit the chart (robotkube registry submit), or take the release from main"
REMOVE = "Delete it; what is to run is proposed as a release (robotkube task submit)"


def strangers_among(workload: Object, kind: str, permitted: Permitted) -> Iterator[Stranger]:
    """What is strange about one workload of an agent's namespace; nothing about one that is being deleted."""
    metadata = workload["metadata"]
    if metadata.get("deletionTimestamp") or _made_by(metadata, kind):
        return
    if kind == SETTINGS_KIND:
        yield from _settings(workload, permitted)
        return
    namespace, name = str(metadata["namespace"]), str(metadata["name"])
    label = str((metadata.get("labels") or {}).get(RELEASE_LABEL, ""))
    shape = permitted.release(namespace, name, label) if kind == CHARTS_KIND else None
    place = f"{kind} {namespace}/{name}"
    if shape is None:
        yield Stranger(kind, namespace, name, NO_RELEASE, f"{place}: no release that main has renders it. {REMOVE}")
        return
    if not permitted.chart(shape.chart):
        text = f"{place}: its chart {shape.chart} is not verified on the catalogue's main. {WITHDRAW}"
        yield Stranger(kind, namespace, name, FOREIGN_CHART, text)
    versions = list(shape.versions(name))
    problem = _otherwise(workload, versions)
    if problem:
        text = f"{place} is not what the chart of release {shape.name} renders: {problem}. {RESTORE}"
        one = Stranger(kind, namespace, name, NOT_OF_THE_CHART, text, uid=str(metadata.get("uid", "")))
        yield replace(one, generation=int(metadata.get("generation") or 0), excess=excess(workload, versions))


def _settings(config_map: Object, permitted: Permitted) -> Iterator[Stranger]:
    """What is strange about a ConfigMap: nothing, where no release renders one of its name. Who mounts such a one is
    named as a workload or a pod."""
    metadata = config_map["metadata"]
    namespace, name = str(metadata["namespace"]), str(metadata["name"])
    key = place(SETTINGS_KIND, name)
    shape = permitted.release(namespace, key)
    problem = _otherwise(config_map, shape.settings(key), differing_keys) if shape else ""
    if shape and problem:
        before = "" if _otherwise(config_map, shape.versions(key), differing_keys) else BEFORE
        what = f"{key.replace('/', f' {namespace}/')} is not what the chart of release {shape.name} renders"
        uid = str(metadata.get("uid", ""))
        yield Stranger(SETTINGS_KIND, namespace, name, NOT_OF_THE_CHART, f"{what}: {problem}{before}. {FIND}", uid=uid)


def _otherwise(
    workload: Object, versions: Iterable[Object], compare: Callable[[Object, Object], Sequence[str]] = differences
) -> str:
    """How a workload differs from what main has; empty when it is as main has or had it."""
    first = ""
    for version in versions:
        problems = compare(workload, version)
        if not problems:
            return ""
        first = first or "; ".join(problems)
    return first


def _made_by(metadata: Object, kind: str) -> bool:
    """Return whether a controller made it of a workload that is looked at itself."""
    owners = {owner.get("kind") for owner in metadata.get("ownerReferences") or () if owner.get("controller")}
    return bool(owners & {"ReplicaSet": {"Deployment"}, "Job": {"CronJob"}}.get(kind, set()))
