"""Changed settings that are at work, as far as readiness says it.

A process that watches its settings is not ready while it does not take them, and its kubelet notices that by the
second probe. A process that began after its release's plan has read them at its start.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass

from robotkube.delivery.manager.core.observation import ApplicationState, ContainerState, PodState
from robotkube.delivery.manager.core.updates.verdicts import plan_ns

SECOND_NS = 1_000_000_000
PROBED_NS = 12 * SECOND_NS
"""Two probes of the library chart (period 5 s, failureThreshold 2), and what the word of their answer takes."""

_Running = tuple[PodState, ContainerState]


def refusals(application: ApplicationState | None, pods: Iterable[PodState]) -> list[str]:
    """A sentence for each container that runs on from before its settings were changed, and is not ready."""
    return [
        f"pod {pod.name}: container {container.name} has run since before its settings were changed and is not ready: "
        "settings refused, or not at work yet; its log says why"
        for pod, container in _older(application, pods)
        if not container.ready
    ]


@dataclass
class _Known:
    """A plan of a release that was first seen healthy at `seen_ns`; `shown` when its settings are at work."""

    plan: str
    seen_ns: int
    shown: bool = False


class SettingsProofs:
    """What readiness has shown of changed settings; `until_ns`: when the next of them is shown, None without one.

    Once they are shown, a later operation of Argo CD with the same plan does not put that in doubt."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._known: dict[str, _Known] = {}
        self.until_ns: int | None = None

    def begin(self, releases: Container[str]) -> None:
        """Begin to look at all releases (keys) that there are; what is known of others is forgotten."""
        self._known = {release: known for release, known in self._known.items() if release in releases}
        self.until_ns = None

    def missing(self, release: str, application: ApplicationState | None, pods: Iterable[PodState]) -> str:
        """Why the settings of a healthy release are not shown to be at work yet; empty when they are."""
        if application is None:
            return ""
        now = self._now_ns()
        known = self._known.get(release)
        if known is None or known.plan != application.plan:
            known = self._known[release] = _Known(application.plan, now)
        if known.shown:
            return ""
        applied = known.seen_ns if application.applied_ns is None else application.applied_ns
        until = min(applied, known.seen_ns) + PROBED_NS  # whatever another machine's clock says
        if now >= until or not any(_older(application, pods)):
            known.shown = True
            return ""
        self.until_ns = until if self.until_ns is None else min(until, self.until_ns)
        return "its settings were changed; it is ready when two probes have found them at work"


def _older(application: ApplicationState | None, pods: Iterable[PodState]) -> Iterator[_Running]:
    """The containers, of those with a readiness probe, that began before the plan which the release is of."""
    planned = plan_ns(application.plan) if application is not None else 0
    for pod in pods:
        for container in pod.containers if not pod.deleting else ():
            if container.probed and container.started_ns is not None and container.started_ns < planned:
                yield pod, container
