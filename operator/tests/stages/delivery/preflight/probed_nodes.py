"""The outcome of a probe of a cluster on which nothing is wrong; a test changes one Node."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from robotkube.delivery.preflight.core.findings import ClusterFinding
from robotkube.delivery.preflight.core.probing.answers import DiskSpace, ProbeAnswer
from robotkube.delivery.preflight.core.probing.checks import PROBE_CHECKS
from robotkube.delivery.preflight.core.probing.objects import ProbeTarget
from robotkube.delivery.preflight.core.probing.outcomes import NodeOutcome, Probed
from tests.stages.delivery.preflight.preflight_facts import facts

IMAGE = f"registry.example/robotkube/platform@sha256:{'1' * 64}"
BROKER = "broker.robotkube.svc.cluster.local"
API = "kubernetes.default.svc.cluster.local"
TARGET = ProbeTarget("robotkube-probe", IMAGE, (API, BROKER), (BROKER, 8883))
NODES = ("cloud-0", "vehicle-00", "vehicle-01")
GIB = 1024**3


def answer(**changed: Any) -> ProbeAnswer:
    """What a pod says on a Node on which nothing is wrong, some of it changed."""
    disks = {"pods": DiskSpace(50 * GIB, 100 * GIB), "images": DiskSpace(50 * GIB, 100 * GIB)}
    good = ProbeAnswer(names={API: "", BROKER: ""}, clock_ahead=0.004, clock_within=0.001, disks=disks)
    return replace(good, **changed)


def outcomes(**changed: NodeOutcome) -> dict[str, NodeOutcome]:
    """Of each Node; `changed` by their names with `_`."""
    after = dict(zip(NODES, (*NODES[1:], NODES[0]), strict=True))
    good = {name: NodeOutcome(True, "", answer(), after[name]) for name in NODES}
    return good | {name.replace("_", "-"): one for name, one in changed.items()}


def answered(name: str, **changed: Any) -> dict[str, NodeOutcome]:
    """Of each Node; one of them answers something else."""
    good = outcomes()
    return good | {name: replace(good[name], answer=answer(**changed))}


def probed(**changed: Any) -> Probed:
    """The outcome, some of it changed."""
    return replace(Probed(TARGET, outcomes(), {}, "", 20.0), **changed)


def probe_finding(check: str, outcome: Any, **changed: Any) -> ClusterFinding:
    """What a check of the probe finds in an outcome, when these facts are changed."""
    given = facts(**{"installed": True, **changed}) | {"probed": outcome}
    return next(one for one in PROBE_CHECKS if one.name == check).finding(given)
