"""Targets: what of the strangers that are named may be taken away, and why the others are left."""

from __future__ import annotations

from dataclasses import dataclass

from robotkube.delivery.inspection.core.strangers import (
    CONTAINER,
    FOREIGN_POD,
    MACHINE,
    NO_RELEASE,
    POD,
    STATIC_POD,
    Stranger,
)

DEPLOYMENT = "Deployment"  # the one kind of workload that releases have
STRANGER_GRACE_SECONDS = 1  # nobody needs what a foreign pod would still finish
SHARED_GRACE_SECONDS = 10  # the agent's own containers end in order beside a foreign one

NOT_AN_AGENTS, NOT_BY_POLICY, NOT_BY_API, NOT_SAID = "NotAnAgents", "NotByPolicy", "CannotBeRemoved", "NotSaid"
LEFT = (NOT_AN_AGENTS, NOT_BY_POLICY, NOT_BY_API, NOT_SAID)


@dataclass(frozen=True)
class RemovalPolicy:
    """What may be taken away: in the namespaces of these `agents`, foreign `pods`, and what was added to `workloads`;
    at most `per_minute` of both together."""

    agents: frozenset[str]
    pods: bool = True
    workloads: bool = True
    per_minute: int = 20


@dataclass(frozen=True, order=True)
class PodTarget:
    """A pod to delete: this one, not another one of its name."""

    namespace: str
    name: str
    uid: str
    grace_seconds: int


@dataclass(frozen=True, order=True)
class WorkloadTarget:
    """A Deployment to restore: at this `generation`, what the JSON pointers `excess` name has to go."""

    namespace: str
    name: str
    uid: str
    generation: int
    excess: tuple[str, ...]


@dataclass(frozen=True)
class Left:
    """Why a stranger is left where it is: a reason of LEFT, and a sentence with what to do."""

    reason: str
    sentence: str


Target = PodTarget | WorkloadTarget | Left


def target_of(stranger: Stranger, looks_at: str, policy: RemovalPolicy) -> Target:
    """What becomes of a stranger of an Inspection that looks at `looks_at`."""
    if stranger.kind == STATIC_POD or stranger.reason == FOREIGN_POD or looks_at == MACHINE:
        return Left(
            NOT_BY_API, f"{stranger} was not started by the API server, so no request to it ends it. {_by(stranger)}"
        )
    if stranger.namespace not in policy.agents:
        return Left(
            NOT_AN_AGENTS,
            f"{stranger} is in no agent's namespace, and the remover has rights in no other. Look at it, and delete it",
        )
    if stranger.kind in (POD, CONTAINER):
        return _pod(stranger, policy)
    return _workload(stranger, policy)


def _by(stranger: Stranger) -> str:
    """What a person does about what no request ends."""
    if stranger.kind == STATIC_POD:
        return "Go to its machine, and take its file out of the kubelet's folder of static pods"
    return "Go to its machine, and stop the container there"


def _pod(stranger: Stranger, policy: RemovalPolicy) -> Target:
    if not policy.pods:
        return Left(NOT_BY_POLICY, f"{stranger} stays: remover.pods is false. Look at it, and delete its pod")
    if not stranger.uid:
        return Left(NOT_SAID, f"{stranger} stays: which pod is meant is not said. Look at it, and delete its pod")
    grace = STRANGER_GRACE_SECONDS if stranger.reason == NO_RELEASE else SHARED_GRACE_SECONDS
    return PodTarget(stranger.namespace, stranger.name, stranger.uid, grace)


def _workload(stranger: Stranger, policy: RemovalPolicy) -> Target:
    if not policy.workloads:
        return Left(NOT_BY_POLICY, f"{stranger} stays: remover.workloads is false. Look at it, and restore it")
    if stranger.kind != DEPLOYMENT or not (stranger.uid and stranger.excess):
        return Left(
            NOT_SAID,
            f"{stranger} stays: only what was added to a release's Deployment is taken away. Argo CD puts back what "
            "the chart has otherwise; delete what no release has (kubectl delete)",
        )
    return WorkloadTarget(stranger.namespace, stranger.name, stranger.uid, stranger.generation, stranger.excess)


def merged(targets: list[WorkloadTarget]) -> list[WorkloadTarget]:
    """The targets, those of one object at one generation as one."""
    together: dict[tuple[str, str, str, int], tuple[str, ...]] = {}
    for target in targets:
        key = (target.namespace, target.name, target.uid, target.generation)
        together[key] = tuple(dict.fromkeys((*together.get(key, ()), *target.excess)))
    return [WorkloadTarget(*key, excess) for key, excess in sorted(together.items())]
