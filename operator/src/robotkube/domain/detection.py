"""Rules over messages: what is an event, when it begins and when it ends. State in, edges out; no clock of its own."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from robotkube.domain.detector_settings import AlwaysRule, ProximityRule, Rule, ThresholdRule
from robotkube.domain.message_fields import number_in
from robotkube.domain.messages import pose_position

START, STOP = "start", "stop"
TASK_NAME_LENGTH_MAX = 63


@dataclass(frozen=True)
class Edge:
    """A rule began (`start`) or ceased (`stop`) to hold for `agents`; both edges of an event have its `id` and `trace`.

    `time`: when the message that crossed the threshold was received, `stamp`: when it was measured; ns since 1970.
    """

    rule: str
    edge: str
    agents: tuple[str, ...]
    id: str
    trace: str
    time: int
    stamp: int
    distance_m: float | None = None


@dataclass(frozen=True)
class _Pose:
    stamp: int
    x: float
    y: float
    z: float


def event_identity(rule: str, agents: Sequence[str], time: int) -> tuple[str, str]:
    """Id (16 hex) and trace (32 hex) of the event that began at `time`; the same for the same event."""
    digest = hashlib.sha256(f"{rule}|{','.join(agents)}|{time}".encode()).hexdigest()
    return digest[:16], digest[16:48]


def task_name(edge: Edge) -> str:
    """The name of the task that an event asks for: a valid object name, the same for the same event."""
    body = f"{edge.rule}-{'-'.join(edge.agents)}".lower()
    body = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in body)
    return f"{body[: TASK_NAME_LENGTH_MAX - 7].strip('-')}-{edge.id[:6]}"


class RuleState(Protocol):
    """A rule with what it remembers."""

    @property
    def rule(self) -> Rule:
        """Its settings."""

    @property
    def active(self) -> tuple[Edge, ...]:
        """The start edges of the events that last."""

    @property
    def reason(self) -> str:
        """Why its events are raised, in words; `{agents}` stands for the agents of an event."""

    def adopt(self, edge: Edge) -> bool:
        """Take over an event that began earlier; False when the rule cannot have it or has it already."""

    def evaluate(self, agent: str, data: bytes, stamp: int, received: int) -> Sequence[Edge]:
        """The edges that this message of `agent` causes; ValueError when it cannot be read."""


class Proximity:
    """The state of one proximity rule: latest pose per agent, and the event of every pair that is close.

    Of two poses of an agent the one with the later stamp counts; a late one is counted in `late` and not used.
    """

    def __init__(self, rule: ProximityRule) -> None:
        self.rule = rule
        self.reason = f"{{agents}} within {rule.start_distance_m:g} m"
        self.late = 0
        self._stale_ns = int(rule.stale_seconds * 1e9)
        self._poses: dict[str, _Pose] = {}
        self._active: dict[tuple[str, ...], Edge] = {}
        self._partners = {agent: tuple(other for other in rule.agents if other != agent) for agent in rule.agents}

    @property
    def active(self) -> tuple[Edge, ...]:
        """The start edges of the events that last."""
        return tuple(self._active.values())

    def adopt(self, edge: Edge) -> bool:
        """Take over an event that began earlier; False when the rule has no such pair or it has an event already."""
        if tuple(sorted(edge.agents)) in self._active or len(edge.agents) != 2:
            return False
        if not set(edge.agents) <= set(self._partners):
            return False
        self._active[tuple(sorted(edge.agents))] = replace(edge, edge=START)
        return True

    def evaluate(self, agent: str, data: bytes, stamp: int, received: int) -> Sequence[Edge]:
        """See the protocol; the message is a PoseStamped."""
        return self.observe(agent, pose_position(data), stamp, received)

    def observe(self, agent: str, position: tuple[float, float, float], stamp: int, received: int) -> Sequence[Edge]:
        """The edges that this pose causes; at most one per pair it belongs to."""
        partners = self._partners.get(agent)
        if partners is None:
            return ()
        known = self._poses.get(agent)
        if known is not None and known.stamp >= stamp:
            self.late += 1
            return ()
        pose = self._poses[agent] = _Pose(stamp, *position)
        return [edge for other in partners for edge in self._compare(agent, other, pose, received)]

    def _compare(self, agent: str, other: str, pose: _Pose, received: int) -> Iterable[Edge]:
        theirs = self._poses.get(other)
        if theirs is None or abs(theirs.stamp - pose.stamp) > self._stale_ns:
            return
        distance = math.dist((pose.x, pose.y, pose.z), (theirs.x, theirs.y, theirs.z))
        pair = (agent, other) if agent < other else (other, agent)
        began = self._active.get(pair)
        if began is None and distance < self.rule.start_distance_m:
            event, trace = event_identity(self.rule.name, pair, received)
            edge = Edge(self.rule.name, START, pair, event, trace, received, pose.stamp, distance)
            self._active[pair] = edge
            yield edge
        elif began is not None and distance > self.rule.stop_distance_m:
            del self._active[pair]
            yield replace(began, edge=STOP, time=received, stamp=pose.stamp, distance_m=distance)


class Threshold:
    """The state of one threshold rule on messages of `type_name`: the event of every agent beyond the threshold."""

    def __init__(self, rule: ThresholdRule, type_name: str) -> None:
        self.rule, self.type = rule, type_name
        self.reason = f"{{agents}}: {rule.field} {'above' if rule.above else 'below'} {rule.start:g}"
        self._active: dict[str, Edge] = {}

    @property
    def active(self) -> tuple[Edge, ...]:
        """See the protocol."""
        return tuple(self._active.values())

    def adopt(self, edge: Edge) -> bool:
        """See the protocol."""
        if len(edge.agents) != 1 or edge.agents[0] in self._active:
            return False
        self._active[edge.agents[0]] = replace(edge, edge=START)
        return True

    def evaluate(self, agent: str, data: bytes, stamp: int, received: int) -> Sequence[Edge]:
        """See the protocol."""
        value = number_in(self.type, self.rule.field, data)
        began = self._active.get(agent)
        sign = 1 if self.rule.above else -1
        if began is None and sign * (value - self.rule.start) > 0:
            event, trace = event_identity(self.rule.name, (agent,), received)
            self._active[agent] = Edge(self.rule.name, START, (agent,), event, trace, received, stamp)
            return (self._active[agent],)
        if began is not None and sign * (value - self.rule.stop) < 0:
            del self._active[agent]
            return (replace(began, edge=STOP, time=received, stamp=stamp),)
        return ()


class Always:
    """The state of a rule that holds from the beginning: one event of `agent`."""

    def __init__(self, rule: AlwaysRule, agent: str) -> None:
        self.rule, self.agent = rule, agent
        self.reason = f"{{agents}}: {rule.name}"
        self._active: Edge | None = None

    @property
    def active(self) -> tuple[Edge, ...]:
        """See the protocol."""
        return (self._active,) if self._active else ()

    def adopt(self, edge: Edge) -> bool:
        """See the protocol."""
        if self._active is not None or edge.agents != (self.agent,):
            return False
        self._active = replace(edge, edge=START)
        return True

    def evaluate(self, agent: str, data: bytes, stamp: int, received: int) -> Sequence[Edge]:
        """Messages change nothing."""
        return ()

    def begin(self, now: int) -> Sequence[Edge]:
        """The start edge, once."""
        if self._active is not None:
            return ()
        event, trace = event_identity(self.rule.name, (self.agent,), now)
        self._active = Edge(self.rule.name, START, (self.agent,), event, trace, now, now)
        return (self._active,)


def rule_state(rule: Rule, types: Mapping[str, str], agent: str) -> RuleState:
    """The beginning of a rule; `types` says the message type of each topic pattern, `agent` whose detector it is."""
    if isinstance(rule, ProximityRule):
        return Proximity(rule)
    if isinstance(rule, ThresholdRule):
        return Threshold(rule, types[rule.topic.text])
    return Always(rule, agent)
