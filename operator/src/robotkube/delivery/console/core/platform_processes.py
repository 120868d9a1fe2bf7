"""Presence of the processes without which what the console shows stands still: gate, forge, and Argo CD's controller,
as their pods say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from robotkube.delivery.console.core import table as kinds

GATE, FORGE, CONTROLLER = "gate", "forge", "argocd-application-controller"
NAMES = (GATE, FORGE, CONTROLLER)
"""Their pods' label app.kubernetes.io/name."""
CARRIES: Mapping[str, tuple[str, ...]] = {
    GATE: (kinds.PLANS, kinds.CATALOGUE),
    FORGE: (kinds.PLANS, kinds.CATALOGUE),
    CONTROLLER: (kinds.RELEASES,),
}
ADVICE: Mapping[str, str] = {
    GATE: "Nothing is merged or published until it is back; what runs goes on. `robotkube status` says what to do.",
    FORGE: "No plan is proposed, merged or deployed until it is back; what runs goes on. Look at its pod.",
    CONTROLLER: "Nothing is deployed or taken away until it is back; what is shown is as of then. Look at its pod.",
}


@dataclass(frozen=True)
class ProcessPod:
    """A pod of such a process: its label, where it is, whether it is ready, and else why not."""

    process: str
    namespace: str
    ready: bool
    why: str


@dataclass(frozen=True)
class Presence:
    """Whether a process is there: `problem` is empty, or a sentence."""

    process: str
    problem: str


class PlatformProcesses:
    """The presences, for one thread. A gate there is where its namespace is known; of the others only those that were
    seen once are told, since forge and Argo CD may be somebody else's."""

    def __init__(self, platform: str, argocd: str, gate: str) -> None:
        """The namespaces of the platform, of Argo CD, and of the gate, empty where it is not known. A pod elsewhere is
        none of them, whatever its labels say."""
        self._places: Mapping[str, str] = {GATE: gate, FORGE: platform, CONTROLLER: argocd}
        self._seen = {GATE} if gate else set()

    def presences(self, pods: Iterable[ProcessPod]) -> Iterator[Presence]:
        """Whether each is there, of these pods."""
        listed = list(pods)
        for process, namespace in self._places.items():
            own = [pod for pod in listed if (pod.process, pod.namespace) == (process, namespace)]
            self._seen |= {process} if own else set()
            if process in self._seen:
                yield Presence(process, _problem(own))


def _problem(pods: Iterable[ProcessPod]) -> str:
    listed = list(pods)
    if any(pod.ready for pod in listed):
        return ""
    if not listed:
        return "There is no pod of it."
    return f"Its pod in {listed[0].namespace} is not ready: {listed[0].why}."
