"""The probe: pods start on each Node, ask each other and the cluster, and are gone again, whatever happens meanwhile.

Two rounds: pods that serve, so that their addresses are known, then on the same Nodes pods that ask. Altogether
START_SECONDS_MAX + ASK_SECONDS_MAX + CLOSE_SECONDS_MAX, less than 60 s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from robotkube.delivery.preflight.core.findings import Unread
from robotkube.delivery.preflight.core.probing.answers import ProbeQuestions, read_answer
from robotkube.delivery.preflight.core.probing.objects import ASK, SERVE, ProbeTarget, pod
from robotkube.delivery.preflight.core.probing.outcomes import NodeOutcome, Probed, ProbePod, last_words, read_pod
from robotkube.delivery.preflight.ports import ProbeCluster
from robotkube.errors import InputError, RobotKubeError

NODES_MAX = 50
START_SECONDS_MAX = 26.0
ASK_SECONDS_MAX = 14.0
CLOSE_SECONDS_MAX = 16.0
POLL_SECONDS = 0.5


@dataclass(frozen=True)
class ProbeClock:
    """The time in seconds that never go back, and a sleep."""

    now: Callable[[], float]
    sleep: Callable[[float], None]


@dataclass(frozen=True)
class Probing:
    """A probe of `nodes`. While `shielded()` is entered, nothing interrupts: what was made is removed there. What an
    interrupted one leaves behind, `say` is told."""

    cluster: ProbeCluster
    target: ProbeTarget
    nodes: Sequence[str]
    unasked: Mapping[str, str]
    clock: ProbeClock
    shielded: Callable[[], AbstractContextManager[None]]
    say: Callable[[str], None]

    def run(self) -> Probed:
        """The outcome. InputError when the account lacks a right, before anything is made."""
        lacking = self.cluster.lacking()
        if lacking:
            raise InputError(f"nothing was started: the account may not {', '.join(lacking)}")
        begin = self.clock.now()
        outcomes: Mapping[str, NodeOutcome] | None = None
        left = ""
        try:
            self.cluster.open()
            outcomes = self._outcomes()
        finally:
            with self.shielded():
                left = self._close()
            if left and outcomes is None:
                name = self.target.namespace
                self.say(f"namespace {name}: {left}; kubectl delete namespace {name}")
        return Probed(self.target, outcomes, self.unasked, left, self.clock.now() - begin)

    def _outcomes(self) -> Mapping[str, NodeOutcome]:
        for node in self.nodes:
            self.cluster.start(pod(self._pod(SERVE, node), node, self.target.image, SERVE))
        serving = self._await(SERVE, self.nodes, START_SECONDS_MAX, lambda state: state.settled)
        up = [node for node in self.nodes if serving[node].runs]
        neighbours = {node: up[(at + 1) % len(up)] for at, node in enumerate(up)}
        for node in up:
            questions = self._questions(serving[up[0]], serving[neighbours[node]])
            self.cluster.start(pod(self._pod(ASK, node), node, self.target.image, ASK, questions))
        asked = self._await(ASK, up, ASK_SECONDS_MAX, lambda state: state.settled and not state.runs)
        return {node: _outcome(serving[node], asked.get(node), neighbours.get(node, "")) for node in self.nodes}

    def _questions(self, clock: ProbePod, neighbour: ProbePod) -> ProbeQuestions:
        host, port = self.target.broker
        return ProbeQuestions(clock.address, neighbour.address, self.target.names, host, port)

    def _pod(self, doing: str, node: str) -> str:
        return f"{doing}-{self.nodes.index(node)}"

    def _await(
        self, doing: str, nodes: Sequence[str], seconds: float, over: Callable[[ProbePod], bool]
    ) -> Mapping[str, ProbePod]:
        """The states of the pods that do this on these Nodes, once all are over or the time is; one that does not run
        has the words of its Events besides."""
        deadline = self.clock.now() + seconds
        while True:
            present = self.cluster.pods()
            states = {node: read_pod(present.get(self._pod(doing, node), {})) for node in nodes}
            if all(over(state) for state in states.values()) or self.clock.now() >= deadline:
                break
            self.clock.sleep(POLL_SECONDS)
        if all(state.runs or state.said for state in states.values()):
            return states
        words = last_words(self.cluster.events())
        return {node: _with_words(state, words.get(self._pod(doing, node), "")) for node, state in states.items()}

    def _close(self) -> str:
        """Remove everything; what is left, and why."""
        deadline = self.clock.now() + CLOSE_SECONDS_MAX
        while True:
            try:
                if self.cluster.close():
                    return ""
                left = f"it is still there {CLOSE_SECONDS_MAX:g} s after its deletion was asked for"
            except RobotKubeError as error:
                left = f"it could not be removed: {error}"
            if self.clock.now() >= deadline:
                return left
            self.clock.sleep(POLL_SECONDS)


def _with_words(state: ProbePod, event: str) -> ProbePod:
    if state.runs or state.said:
        return state
    return replace(state, words="; ".join(dict.fromkeys(filter(None, (state.words, event)))))


def _outcome(serving: ProbePod, asked: ProbePod | None, neighbour: str) -> NodeOutcome:
    if asked is None:
        why = serving.words or "its kubelet says nothing"
        return NodeOutcome(serving.pulled, serving.words, Unread(f"no pod of the probe runs there: {why}"))
    if asked.said:
        return NodeOutcome(True, "", read_answer(asked.said), neighbour)
    why = asked.words or f"it did not end within {ASK_SECONDS_MAX:g} s"
    return NodeOutcome(True, "", Unread(f"its pod gave no answer: {why}"), neighbour)
