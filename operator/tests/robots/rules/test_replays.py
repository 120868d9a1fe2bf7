"""Live and replay: whenever the clock is looked at, and in whatever form bytes come, events are the same or none."""

from __future__ import annotations

import random
from typing import Any

import pytest

from robotkube.robots.rules.core import START, Edge, Message
from tests.stages.detector.rules import MS, NOW, NUMBER, NUMBERS, POSE, POSES, SECOND, TEXT, RuleStage, number, pose
from tests.stages.examples import EXAMPLES

CASES = [EXAMPLES, pytest.param(3000, marks=pytest.mark.thorough)]
RULES: list[dict[str, Any]] = [
    {"name": "near", "kind": "proximity", "topic": POSES, "start_distance_m": 8, "stop_distance_m": 11,
     "expire_seconds": 2, "sustained_seconds": 0.3},
    {"name": "yard", "kind": "geofence", "topic": POSES, "expire_seconds": 1.5, "cooldown_seconds": 0.7,
     "area": {"type": "Polygon", "coordinates": [[[0, -10], [10, -10], [10, 10], [0, 10]]]}},
    {"name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
     "sustained_seconds": 0.2, "minimum_interval_seconds": 1, "expire_seconds": 2},
    {"name": "slow", "kind": "rate", "topic": NUMBERS, "start_below_hz": 3, "stop_above_hz": 4, "window_seconds": 1},
    {"name": "fast", "kind": "rate", "topic": NUMBERS, "start_above_hz": 7, "stop_below_hz": 5, "window_seconds": 1},
    {"name": "lost", "kind": "absence", "topic": POSES, "seconds": 0.6},
    {"name": "crowd", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
     "scope": "group", "agents": ["vehicle-00", "vehicle-01", "vehicle-02"], "at_least": 2, "expire_seconds": 30},
    {"name": "few", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
     "scope": "group", "agents": ["vehicle-00", "vehicle-01", "vehicle-02"], "at_least": 2, "expire_seconds": 2,
     "sustained_seconds": 0.2, "minimum_interval_seconds": 1},
    {"name": "close", "kind": "proximity", "topic": POSES, "start_distance_m": 8, "stop_distance_m": 11,
     "scope": "group", "agents": ["vehicle-00", "vehicle-01", "vehicle-02"], "at_least": 2, "expire_seconds": 2},
    {"name": "gathered", "kind": "geofence", "topic": POSES, "scope": "group", "at_least": 2, "expire_seconds": 2,
     "sustained_seconds": 0.2, "area": {"type": "Polygon", "coordinates": [[[-6, -10], [9, -10], [9, 10], [-6, 10]]]}},
    {"name": "both", "kind": "combination", "all": ["yard", "high"]},
    {"name": "pairs", "kind": "combination", "all": ["near", {"not": "high"}], "scope": "pair"},
]  # fmt: skip


def journey(chance: random.Random) -> list[tuple[str, float | tuple[float, ...], float]]:
    """Messages of three agents with pauses of all lengths, each with its own stamp (s), received within 50 ms."""
    at = 0.0
    messages = []
    for _ in range(120):
        at += chance.choice((0.02, 0.05, 0.05, 0.1, 0.2, 0.4, 0.9, 2.5))
        value = chance.uniform(0, 8) if chance.random() < 0.5 else (chance.uniform(-12, 12), 0.0, 0.0)
        messages.append((f"vehicle-0{chance.randrange(3)}", value, round(at, 3)))
    return messages


def told(edges: list[Edge]) -> list[tuple[str, ...]]:
    return sorted((edge.rule, edge.edge, *edge.agents, edge.id, str(edge.stamp - NOW)) for edge in edges)


@pytest.mark.parametrize("cases", CASES)
def test_when_the_clock_is_looked_at_does_not_matter(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        messages = journey(chance)
        often, never = RuleStage(*RULES), RuleStage(*RULES)
        edges: list[Edge] = []
        now = 0.0
        for agent, value, at in messages:
            while now < at:
                edges += often.tick(now)
                now += chance.choice((0.02, 0.02, 0.3, 1.0))
            edges += often.send(agent, value, at, at + chance.uniform(0, 0.05))
        seen = [edge for message in messages for edge in never.send(*message)]
        end = messages[-1][2] + 10
        simple = {"near", "yard", "high", "slow", "fast", "lost", "crowd", "few", "close"}
        one = told([edge for edge in [*edges, *often.tick(end)] if edge.rule in simple])
        other = told([edge for edge in [*seen, *never.tick(end)] if edge.rule in simple])
        assert one == other, seed


@pytest.mark.parametrize("cases", CASES)
def test_every_event_begins_once_and_ends_once(cases: int) -> None:
    for seed in range(cases):
        chance = random.Random(seed)  # noqa: S311 - the same cases every time
        stage = RuleStage(*RULES)
        lasting = {}
        edges: list[Edge] = []
        for agent, value, at in journey(chance):
            edges += [*stage.tick(at), *stage.send(agent, value, at)]
        for edge in edges:
            key = edge.rule, edge.agents
            if edge.edge == START:
                assert key not in lasting, seed
                lasting[key] = edge
            else:
                began = lasting.pop(key)
                assert (began.id, began.trace) == (edge.id, edge.trace), seed
                assert began.stamp <= edge.stamp, seed
        assert {edge.id for edge in lasting.values()} == {edge.id for edge in stage.engine.active}, seed


@pytest.mark.parametrize("cases", [5 * EXAMPLES, pytest.param(20_000, marks=pytest.mark.thorough)])
def test_whatever_the_bytes_are_nothing_is_raised(cases: int) -> None:
    stage = RuleStage(*RULES)
    chance = random.Random(7)  # noqa: S311 - the same cases every time
    good = [number(6), pose(3, 4), b""]
    for step in range(cases):
        data = bytearray(chance.choice(good))
        for _ in range(chance.randrange(4)):
            if data:
                data[chance.randrange(len(data))] = chance.randrange(256)
        data = data[: chance.randrange(len(data) + 1)] if chance.random() < 0.5 else data
        topic = f"/vehicles/{chance.choice(('vehicle_00', 'v', 'x_1'))}/{chance.choice(('pose', 'value', 'other'))}"
        stamp = NOW + chance.choice((step * MS, -SECOND, 0, 2**62, -(2**62), step * SECOND))
        type_name = chance.choice((POSE, NUMBER, TEXT, "unknown_msgs/msg/Nothing", "no type"))
        edges = stage.engine.observe(Message(topic, type_name, stamp, NOW + step * MS, bytes(data)))
        assert all(edge.rule for edge in edges)
        stage.tick(step / 100)
    assert stage.engine.counts.malformed
    assert ("high", "/vehicles/v/value") in stage.engine.problems
