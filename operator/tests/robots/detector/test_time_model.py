"""Buffer and rules together, over random streams: every message is somewhere, and every rule is what it is said to be.

The stream goes through a live detector and through `rule test`. What each of them gives to its rules is held against a
plain model of the buffer, message by message; the edges of the rules against their definitions over what they got.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings

from robotkube.robots.detector.loops import detector as detector_module
from robotkube.robots.ros.core.ring_buffers import (
    AHEAD,
    DISORDERED,
    DUPLICATE,
    JUMPED,
    KEPT,
    LATE,
    BufferBounds,
    Sample,
)
from robotkube.robots.ros.core.source_clocks import DISORDER_NS_MAX
from robotkube.robots.rules.core import Edge, Message, RuleEngine
from tests.stages.detector import rule_definitions as definitions
from tests.stages.detector.random_streams import (
    AGENTS,
    LATENCY_MAX,
    Disturbance,
    disturbances,
    epochs,
    seeds,
    stream,
)
from tests.stages.detector.rule_definitions import Step
from tests.stages.detector.rules import MS, NOW, POSES, SECOND
from tests.stages.detector.streams import TURN_NS, Sent, document, lived, replayed
from tests.stages.examples import EXAMPLES
from tests.stages.ros.buffer_model import ModelBuffer

RULES: list[dict[str, Any]] = [
    {"name": "near", "kind": "proximity", "topic": POSES, "start_distance_m": 8, "stop_distance_m": 11,
     "expire_seconds": 86400},
    {"name": "east", "kind": "threshold", "topic": POSES, "field": "pose.position.x", "start_above": 5,
     "stop_below": -5, "expire_seconds": 86400},
    {"name": "yard", "kind": "geofence", "topic": POSES, "expire_seconds": 86400,
     "area": {"type": "Polygon", "coordinates": [[[5, -9], [9999, -9], [9999, 9], [5, 9]]]}},
    {"name": "lost", "kind": "absence", "topic": POSES, "seconds": 0.5},
    {"name": "slow", "kind": "rate", "topic": POSES, "start_below_hz": 7, "stop_above_hz": 8, "window_seconds": 1},
    {"name": "there", "kind": "combination", "all": ["near", {"not": "lost"}]},
]  # fmt: skip
SETTINGS = document(*RULES)
REORDERED = (LATENCY_MAX + 16) * MS
"""Messages of different agents may be looked at in another order by so much."""
BELIEVED = (KEPT, DISORDERED, JUMPED)


class Run(NamedTuple):
    """What came of a stream: edges by rule, agent -> reason -> messages that no rule saw, and what the rules got."""

    edges: Mapping[str, definitions.Edges]
    unseen: Mapping[str, Mapping[str, int]]
    steps: Sequence[Step]


class TracedEngine(RuleEngine):
    """The rules, and a list of what they get; `at`: the clock's time of each step."""

    steps: list[Step] = []  # noqa: RUF012 - of one run

    def observe(self, message: Message) -> list[Edge]:
        (x,) = struct.unpack_from("<d", message.data, 20)
        edges = super().observe(message)  # looks at the clock before, where it has to
        self._note("observe", message.topic, message.stamp, message.received, x)
        return edges

    def overlook(self, topic: str, received: int) -> None:
        self._note("overlook", topic, 0, received)
        super().overlook(topic, received)

    def restart(self, topic: str, stamp: int) -> None:
        self._note("restart", topic, stamp, 0)
        super().restart(topic, stamp)

    def tick(self, now: int) -> list[Edge]:
        self._note("tick", "", 0, now)
        return super().tick(now)

    def _note(self, kind: str, topic: str, stamp: int, clock: int, x: float = 0.0) -> None:
        agent = topic.split("/")[2].replace("_", "-") if topic else ""
        self.steps.append(Step(kind, agent, stamp - NOW, clock - NOW, x))


def by_replay(sent: Sequence[Sent]) -> Run:
    TracedEngine.steps = []
    edges, result = replayed(sent, SETTINGS)
    return _run(edges, result.unseen)


def by_life(sent: Sequence[Sent]) -> Run:
    TracedEngine.steps = []
    edges, stage = lived(sent, SETTINGS)
    return _run(edges, stage.detector.unseen.topics())


def _run(edges: Sequence[Any], unseen: Mapping[str, Mapping[str, int]]) -> Run:
    by_rule: dict[str, definitions.Edges] = {rule["name"]: [] for rule in RULES}
    for edge in edges:
        by_rule[edge.rule].append((edge.edge, edge.agents, edge.stamp))
    return Run(by_rule, {topic.split("/")[2].replace("_", "-"): n for topic, n in unseen.items()}, TracedEngine.steps)


@pytest.fixture(autouse=True, scope="module")
def _traced() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(detector_module, "RuleEngine", TracedEngine)
        yield


WAYS = pytest.mark.parametrize("way", [by_replay, by_life])
Way = Callable[[Sequence[Sent]], Run]


class Verdict(NamedTuple):
    """What the plain buffer says of a message, and the newest message of its source before it."""

    sent: Sent
    outcome: str
    newest: Sample | None


def judged(sent: Sequence[Sent], agent: str) -> list[Verdict]:
    """The verdicts on an agent's messages, in the order of their reception."""
    model = ModelBuffer(BufferBounds(10.0, 50_000_000), False, "drop", "restart")
    verdicts = []
    for message in (m for m in sent if m.agent == agent):
        newest = model.newest
        outcome = model.insert(Sample(message.stamp, message.received, message.data))
        verdicts.append(Verdict(message, outcome, newest))
    return verdicts


def check_what_rules_get(sent: Sequence[Sent], run: Run) -> None:
    """Rules get what the buffer believes, begin anew when it does, and the rest is told."""
    for agent in AGENTS:
        verdicts = judged(sent, agent)
        steps = [step for step in run.steps if step.agent == agent]
        expected: list[tuple[str, set[int]]] = [("", set())]
        for verdict in verdicts:
            if verdict.outcome == JUMPED:
                expected.append((f"restart {verdict.sent.stamp}", set()))
            if verdict.outcome in BELIEVED:
                expected[-1][1].add(verdict.sent.stamp)
        got: list[tuple[str, set[int]]] = [("", set())]
        for step in steps:
            if step.kind == "restart":
                got.append((f"restart {step.stamp}", set()))
            elif step.kind == "observe":
                got[-1][1].add(step.stamp)
        assert got == expected, agent
        refused = [v.outcome for v in verdicts if v.outcome in (LATE, AHEAD)]
        behind = [step for step in definitions.believed(steps) if step.kind == "behind"]
        counts = {"late": refused.count(LATE), "ahead": refused.count(AHEAD), "disordered": len(behind)}
        assert run.unseen.get(agent, {}) == {reason: n for reason, n in counts.items() if n}, agent
        assert sum(step.kind == "overlook" for step in steps) == len(refused)
        assert sum(step.kind == "observe" for step in steps) == sum(v.outcome in BELIEVED for v in verdicts)
        assert len(verdicts) - sum(v.outcome == DUPLICATE for v in verdicts) == len(refused) + sum(
            step.kind == "observe" for step in steps
        )


def check_edges(run: Run, wrong: Sequence[Disturbance]) -> None:
    """Every rule is what it is defined to be, over what the rules got."""
    steps = definitions.believed(run.steps)
    expected = {
        "near": definitions.nearness(steps, 8, 11, SECOND),
        "east": definitions.level(steps, 5, -5),
        "yard": definitions.level(steps, 5, 5),
        "lost": definitions.absence(steps, SECOND // 2),
        "slow": definitions.rate(steps, 7, 8, SECOND),
    }
    for rule, edges in expected.items():
        unclear = definitions.ambiguous([*edges, *run.edges[rule]], steps)
        one, other = ([edge for edge in some if edge[1] not in unclear] for some in (run.edges[rule], edges))
        assert sorted(one, key=_order) == sorted(other, key=_order), rule
    if {each.kind for each in wrong} <= {"silence", "duplicate"}:
        there = definitions.both(expected["near"], expected["lost"], AGENTS)
        assert definitions.longest_difference(run.edges["there"], there, AGENTS) <= REORDERED


def _order(edge: tuple[str, tuple[str, ...], int]) -> tuple[int, tuple[str, ...], str]:
    return edge[2], edge[1], edge[0]


def check_what_is_overlooked(sent: Sequence[Sent], run: Run) -> None:
    """Rules wait as long as the source's messages were late before, so that such a delay costs no message again."""
    steps = definitions.believed(run.steps)
    for agent in AGENTS:
        behind = {step.stamp for step in steps if step.kind == "behind" and step.agent == agent}
        known: list[tuple[int, int]] = []
        offset = 1 << 80
        for message, outcome, newest in judged(sent, agent):
            if outcome == JUMPED:
                known = []
                offset = 1 << 80
            if outcome != DISORDERED or newest is None or newest.stamp - message.stamp > DISORDER_NS_MAX:
                continue
            offset = min(offset, newest.received - newest.stamp)
            late = message.received - message.stamp - offset
            if message.stamp in behind:
                before = [known_late for known_late, passed in known if passed < message.stamp]
                assert late > min(max(before, default=0), DISORDER_NS_MAX), agent
            known.append((late, newest.stamp))


def check_order(sent: Sequence[Sent], run: Run) -> None:
    """Of sources that keep their order everything is looked at at once, turn by turn in the order of stamps, whatever
    their clocks say and however long they are silent."""
    assert run.unseen == {}
    observed = [step for step in run.steps if step.kind == "observe"]
    assert len(observed) == len(sent)
    assert all(a.stamp <= b.stamp or a.clock - b.clock < TURN_NS for a, b in pairwise(observed))


@WAYS
@settings(max_examples=EXAMPLES // 2)  # each is a stream of 240 messages
@given(seed=seeds, wrong=disturbances, epoch=epochs)
def test_buffer_and_rules_are_what_they_are_defined_to_be(
    way: Way, seed: int, wrong: list[Disturbance], epoch: int
) -> None:
    sent = stream(seed, wrong, epoch)
    run = way(sent)
    check_what_rules_get(sent, run)
    check_what_is_overlooked(sent, run)
    check_edges(run, wrong)
    if {each.kind for each in wrong} <= {"skew", "silence"}:
        check_order(sent, run)
