"""Whether processes are there that the console reads nothing of, but without which what it shows stands still: gate,
forge, and Argo CD's controller, as their pods say."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
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
    """Says it, for one thread. A gate there always is; of the others only those are told that were seen once, since the
    forge may be somebody else's, and Argo CD, too."""

    def __init__(self, platform: str, argocd: str, agents: Collection[str]) -> None:
        """The namespaces of the platform, of Argo CD, and of agents: nobody is the gate there."""
        self._places: Mapping[str, Callable[[str], bool]] = {
            GATE: lambda namespace: namespace not in agents,
            FORGE: lambda namespace: namespace == platform,
            CONTROLLER: lambda namespace: namespace == argocd,
        }
        self._seen = {GATE}

    def presences(self, pods: Iterable[ProcessPod]) -> Iterator[Presence]:
        """Whether each is there, of these pods."""
        listed = list(pods)
        for process, belongs in self._places.items():
            own = [pod for pod in listed if pod.process == process and belongs(pod.namespace)]
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
