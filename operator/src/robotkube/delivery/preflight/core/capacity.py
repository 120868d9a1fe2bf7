"""Capacity: whether the pods of the chart find Nodes, by selectors, taints and what is free of cpu and memory.

Pods are placed one after the other, the largest first, as a scheduler could. Affinity is not read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from robotkube.delivery.preflight.core.agents import is_ready
from robotkube.delivery.preflight.core.findings import CheckVerdict, Problem, named
from robotkube.delivery.preflight.core.renderings import (
    BEFORE_DELETION,
    Object,
    RenderedChart,
    Workload,
    labels_of,
    metadata_of,
    name_of,
)
from robotkube.foundation.documents.core.quantities import quantity, written
from robotkube.registry.suites.core.pod_security import items, mapping

RESOURCES = ("cpu", "memory")
OVER = ("Succeeded", "Failed")
KEPT_OUT = ("NoSchedule", "NoExecute")
PART_OF = "app.kubernetes.io/part-of"
ENOUGH = Decimal(0)
Amounts = Mapping[str, Decimal]


@dataclass
class _Candidate:
    """A Node that takes pods, and what is free on it."""

    node: Object
    free: dict[str, Decimal] = field(default_factory=dict)

    def takes(self, asked: Amounts) -> bool:
        return all(self.free[name] >= asked[name] for name in RESOURCES)

    def take(self, asked: Amounts) -> None:
        for name in RESOURCES:
            self.free[name] -= asked[name]


def capacity(rendering: RenderedChart, nodes: Sequence[Object], pods: Sequence[Object]) -> CheckVerdict:
    """Each pod of the chart finds a Node. Pods of the platform that run already are not counted as another's."""
    candidates = _candidates(rendering, nodes, pods)
    wanted = [one for one in rendering.workloads if BEFORE_DELETION not in one.hook]
    copies = [(workload, requests(workload.pod.spec)) for workload in wanted for _ in range(workload.replicas)]
    problems: list[Problem] = []
    for workload, asked in sorted(copies, key=lambda copy: (copy[1]["memory"], copy[1]["cpu"]), reverse=True):
        eligible = [candidate for candidate in candidates if _admits(candidate.node, workload.pod.spec)]
        chosen = max(
            (candidate for candidate in eligible if candidate.takes(asked)),
            key=lambda candidate: candidate.free["memory"],
            default=None,
        )
        if chosen is not None:
            chosen.take(asked)
        else:
            problems.append(_unplaced(workload, asked, eligible))
    total = {name: sum((asked[name] for _, asked in copies), ENOUGH) for name in RESOURCES}
    says = f"{len(copies)} pods ask for {_words(total)}; {len(candidates)} Nodes are ready and take pods"
    return CheckVerdict(says, problems)


def requests(pod: Mapping[str, Any]) -> Amounts:
    """What a pod asks for: its containers together, sidecars among them, or the largest of the other init containers
    when that is more."""
    first = items(pod.get("initContainers"))
    beside = [*items(pod.get("containers")), *(one for one in first if one.get("restartPolicy") == "Always")]
    return {name: max(sum(_asked(beside, name), ENOUGH), *_asked(first, name), ENOUGH) for name in RESOURCES}


def _asked(containers: Sequence[Mapping[str, Any]], name: str) -> list[Decimal]:
    stated = [mapping(container.get("resources")) for container in containers]
    amounts = [mapping(one.get("requests")).get(name, mapping(one.get("limits")).get(name)) for one in stated]
    return [quantity(amount) or ENOUGH for amount in amounts]


def _candidates(rendering: RenderedChart, nodes: Sequence[Object], pods: Sequence[Object]) -> list[_Candidate]:
    usable = [node for node in nodes if is_ready(node) and not mapping(node.get("spec")).get("unschedulable")]
    candidates = {name_of(node): _Candidate(node, _allocatable(node)) for node in usable}
    own = {workload.namespace for workload in rendering.workloads}
    for pod in pods:
        spec = mapping(pod.get("spec"))
        phase = mapping(pod.get("status")).get("phase")
        ours = metadata_of(pod).get("namespace") in own and labels_of(pod).get(PART_OF) == "robotkube"
        candidate = candidates.get(str(spec.get("nodeName", "")))
        if candidate is not None and phase not in OVER and not ours:
            candidate.take(requests(spec))
    return list(candidates.values())


def _allocatable(node: Object) -> dict[str, Decimal]:
    stated = mapping(mapping(node.get("status")).get("allocatable"))
    return {name: quantity(stated.get(name)) or ENOUGH for name in RESOURCES}


def _admits(node: Object, pod: Mapping[str, Any]) -> bool:
    present = labels_of(node)
    selected = all(present.get(key) == value for key, value in mapping(pod.get("nodeSelector")).items())
    taints = [one for one in items(mapping(node.get("spec")).get("taints")) if one.get("effect") in KEPT_OUT]
    return selected and all(any(_tolerates(one, taint) for one in items(pod.get("tolerations"))) for taint in taints)


def _tolerates(toleration: Mapping[str, Any], taint: Mapping[str, Any]) -> bool:
    if toleration.get("effect") not in (None, "", taint.get("effect")):
        return False
    if toleration.get("operator") == "Exists":
        return toleration.get("key") in (None, "", taint.get("key"))
    return toleration.get("key") == taint.get("key") and toleration.get("value", "") == taint.get("value", "")


def _unplaced(workload: Workload, asked: Amounts, eligible: Sequence[_Candidate]) -> Problem:
    why = "its pod stays Pending, and the installation waits until its time is over"
    if not eligible:
        selector = mapping(workload.pod.spec.get("nodeSelector"))
        said = ", ".join(f"{key}={value}" for key, value in sorted(selector.items())) or "none"
        what = f"no Node that is ready has its labels ({said}) and no taint beyond its tolerations"
        fix = "platform.nodeSelector and platform.tolerations (or the component's own) in the values, or label a Node"
        return Problem(what, workload.place, why, fix)
    names = named([name_of(candidate.node) for candidate in eligible])
    what = f"none of its Nodes ({names}) has {_words(asked)} free beside the other pods"
    return Problem(
        what, workload.place, why, "the component's resources.requests in the values, or a larger or further Node"
    )


def _words(amounts: Amounts) -> str:
    return ", ".join(f"{name} {written(amounts[name], name)}" for name in RESOURCES)
