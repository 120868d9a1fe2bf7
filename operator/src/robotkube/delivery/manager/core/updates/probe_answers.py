"""Answers of probes as pods' statuses show them: what a version's measure of success is held against.

Kubelets ask the probes. That a container restarted stays in its pod's status; that its readiness probe said no for a
while does not, so whoever watches pods notes it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from robotkube.delivery.manager.core.observation import ContainerState, PodState

LOSSES_MAX = 10_000
SAID_NO = "said no to its readiness probe"


@dataclass(frozen=True)
class ProbeLoss:
    """A time (ns since 1970) at which a container's readiness was lost, and how; `release` is its key, `pod` the
    uid."""

    release: str
    pod: str
    container: str
    time_ns: int
    text: str = SAID_NO


@dataclass(frozen=True)
class ProbeFault:
    """What was wrong with a container, when (ns since 1970), in words. `at_any_time`: also before its release was
    healthy for the first time."""

    container: str
    time_ns: int
    text: str
    at_any_time: bool = False


@dataclass(frozen=True)
class ProbeAnswers:
    """The answers of a release's probes: `containers` that have a readiness probe, by name, and what was wrong with
    them."""

    containers: frozenset[str] = frozenset()
    faults: tuple[ProbeFault, ...] = ()


def losses_between(before: PodState | None, now: PodState | None, now_ns: int) -> Iterable[ProbeLoss]:
    """The losses that two states of one pod show, at `now_ns` when its status does not say when. One that began and
    ended between them shows in the time since which the pod is ready; with several probes it is nobody's."""
    if before is None or now is None or before.uid != now.uid or now.deleting:
        return
    known = {container.name: container for container in before.containers}
    lost = [
        container
        for container in now.containers
        if container.probed and not container.ready and container.name in known
    ]
    for one in lost:
        if known[one.name].ready:
            yield ProbeLoss(now.release, now.uid, one.name, now.unready_since or now_ns, _loss(one))
    probed = [container for container in now.containers if container.probed]
    again = now.ready_since is not None and before.ready_since is not None and now.ready_since > before.ready_since
    if again and len(probed) == 1 and now.ready_since is not None:
        yield ProbeLoss(now.release, now.uid, probed[0].name, now.ready_since)


class ProbeLosses:
    """The last LOSSES_MAX losses that were seen; `note` from any thread."""

    def __init__(self) -> None:
        self._losses: deque[ProbeLoss] = deque(maxlen=LOSSES_MAX)

    def note(self, before: PodState | None, now: PodState | None, now_ns: int) -> bool:
        """Note what two states of one pod show; whether there was anything."""
        losses = list(losses_between(before, now, now_ns))
        self._losses.extend(losses)
        return bool(losses)

    def all(self) -> Sequence[ProbeLoss]:
        """The losses, in the order in which they were seen."""
        return tuple(self._losses)


def probe_answers(pods: Iterable[PodState], losses: Iterable[ProbeLoss]) -> ProbeAnswers:
    """The answers of one release's probes. Pods that are being deleted are those that it had before."""
    there = [pod for pod in pods if not pod.deleting]
    probed = [(pod, container) for pod in there for container in pod.containers if container.probed]
    faults = [_restart(one, one.ended_ns) for _, one in probed if one.restarts and one.ended_ns is not None]
    named = {(pod.uid, one.name) for pod, one in probed}
    faults += [
        ProbeFault(loss.container, loss.time_ns, loss.text) for loss in losses if (loss.pod, loss.container) in named
    ]
    return ProbeAnswers(frozenset(one.name for _, one in probed), tuple(faults))


def _loss(container: ContainerState) -> str:
    """Its probe said no, or there was nobody any more to ask."""
    has_ended = container.started_ns is None and container.ended_why
    return f"ended ({container.ended_why})" if has_ended else SAID_NO


def _restart(container: ContainerState, ended_ns: int) -> ProbeFault:
    return ProbeFault(container.name, ended_ns, f"ended ({container.ended_why}) and was started again", True)
