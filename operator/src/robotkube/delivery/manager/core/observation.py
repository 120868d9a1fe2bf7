"""Observation of plans: the fields of the cluster that show what a plan wrote, and the rule over them.

With an OCI chart source Argo CD's revision is the chart's digest, not the Git commit, so a changed release looks
synced before anything was compared. A release counts as observed only when the plan's annotation is there AND what was
compared and what was applied equal what is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

NODE_SILENT_SECONDS_MAX = 40.0
NOT_COMPARED = "Unknown"


@dataclass(frozen=True)
class ApplicationState:
    """The fields of an Argo CD Application that decide. `source`, `compared_source`, `synced_source` are compared as a
    whole; `plan` is its annotation robotkube.io/plan; `conditions` are its messages for people. `health_since` and
    `applied_ns`, the end of its last operation, are in ns since 1970, None when Argo CD does not say it."""

    name: str
    plan: str = ""
    source: Mapping[str, Any] = field(default_factory=dict)
    compared_source: Mapping[str, Any] = field(default_factory=dict)
    synced_source: Mapping[str, Any] = field(default_factory=dict)
    phase: str = ""
    sync: str = ""
    health: str = ""
    conditions: tuple[str, ...] = ()
    deleting: bool = False
    health_since: int | None = None
    applied_ns: int | None = None


@dataclass(frozen=True)
class ContainerState:
    """A container of a pod as its kubelet reports it: `probed` when it has a readiness probe, `ready` while that says
    yes; since when it runs, how often it was started again, when it ended last (ns since 1970; None: never, or by no
    end of its own), why, and what its kubelet kept of its last words; `waiting` says why it cannot begin."""

    name: str
    probed: bool = False
    ready: bool = False
    restarts: int = 0
    ended_ns: int | None = None
    ended_why: str = ""
    last_words: str = ""
    started_ns: int | None = None
    waiting: str = ""


@dataclass(frozen=True)
class PodState:
    """A pod of a release: `deleting` when it has a deletion time; `node_silent_seconds` is how long its Node has not
    reported (0 while it reports), `node_gone` that there is no such Node any more; `images` are the digests that its
    containers run. `ready_since` or `unready_since`: since when all `containers` are ready, or are not (ns)."""

    namespace: str
    name: str
    release: str
    node: str = ""
    deleting: bool = False
    node_silent_seconds: float = 0.0
    images: tuple[str, ...] = ()
    node_gone: bool = False
    uid: str = ""
    containers: tuple[ContainerState, ...] = ()
    ready_since: int | None = None
    unready_since: int | None = None


@dataclass(frozen=True)
class ReleaseVerdict:
    """The observation of one release of a plan. `annotated`: Argo CD knows the plan. `synced`: it compared and applied
    it. `done`: observed. `message` says what is still missing, or which pods are out of reach. `stuck`: Argo CD could
    not compare (the forge was away, say) and does so again by itself only after minutes. `unreachable`: deleted pods on
    silent nodes, which nobody can ask; they hold nothing up, and what is done is closed when there are none left."""

    annotated: bool
    synced: bool
    done: bool
    message: str
    stuck: bool = False
    unreachable: tuple[str, ...] = ()


def judge_present(application: ApplicationState | None, plan: str) -> ReleaseVerdict:
    """The verdict about a release that `plan` wrote: the rule of the design."""
    if application is None:
        return ReleaseVerdict(False, False, False, "its Argo CD Application does not exist yet")
    if application.plan != plan or application.deleting:
        state = "is being deleted" if application.deleting else f"shows plan {application.plan or 'none'}"
        return ReleaseVerdict(False, False, False, f"its Argo CD Application {state}")
    missing = [
        text
        for text, holds in (
            ("the new source is not compared yet", application.compared_source == application.source),
            ("the new source is not applied yet", application.synced_source == application.source),
            (f"operation is {application.phase or 'not started'}", application.phase == "Succeeded"),
            (f"sync is {application.sync or 'unknown'}", application.sync == "Synced"),
        )
        if not holds
    ]
    if missing:
        stuck = application.sync == NOT_COMPARED
        return ReleaseVerdict(True, False, False, "; ".join([*missing, *application.conditions]), stuck)
    if application.health != "Healthy":
        return ReleaseVerdict(
            True, True, False, "; ".join([f"health is {application.health or 'unknown'}", *application.conditions])
        )
    return ReleaseVerdict(True, True, True, "")


def judge_removed(application: ApplicationState | None, pods: Sequence[PodState]) -> ReleaseVerdict:
    """The verdict about a release that a plan removed: Application and pods are gone. A deleted pod on a node that has
    been silent for longer than NODE_SILENT_SECONDS_MAX is out of reach and named; it does not hold the plan back, nor
    does an Application whose deletion waits for such pods only. A pod of a Node that was deleted counts as gone."""
    there = [pod for pod in pods if not (pod.deleting and pod.node_gone)]
    lost = [pod for pod in there if pod.deleting and pod.node_silent_seconds > NODE_SILENT_SECONDS_MAX]
    waits_for_lost = application is not None and application.deleting and bool(lost) and len(lost) == len(there)
    if application is not None and not waits_for_lost:
        what = "is being deleted" if application.deleting else "still exists"
        return ReleaseVerdict(application.deleting, False, False, f"its Argo CD Application {what}")
    alive = [pod.name for pod in there if pod not in lost]
    if alive:
        return ReleaseVerdict(True, True, False, f"pods still exist: {', '.join(sorted(alive))}")
    message = ", ".join(f"pod {pod.name} is out of reach on silent node {pod.node}" for pod in lost)
    return ReleaseVerdict(True, True, True, message, unreachable=tuple(f"{pod.namespace}/{pod.name}" for pod in lost))
