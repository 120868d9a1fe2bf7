"""Rules of a group: one event for all its agents, listed or whoever is heard of."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.robots.rules.core import START, STOP
from tests.stages.detector.rules import NUMBERS, POSES, RuleStage, seconds

HIGH: dict[str, Any] = {
    "name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
}  # fmt: skip
FENCE: dict[str, Any] = {
    "name": "yard", "kind": "geofence", "topic": POSES,
    "area": {"type": "Polygon", "coordinates": [[[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]]},
}  # fmt: skip


def test_a_group_has_one_event_while_it_holds_for_enough_of_its_members() -> None:
    agents = ["vehicle-00", "vehicle-01", "vehicle-02"]
    stage = RuleStage({**HIGH, "scope": "group", "agents": agents, "at_least": 2})
    sent = [
        ("vehicle-00", 9),
        ("vehicle-09", 9),
        ("vehicle-01", 9),
        ("vehicle-02", 9),
        ("vehicle-01", 1),
        ("vehicle-00", 1),
    ]
    edges = [
        (step, *edge[:2])
        for step, (agent, value) in enumerate(sent)
        for edge in seconds(stage.send(agent, value, step))
    ]
    assert edges == [(2, START, tuple(agents)), (5, STOP, tuple(agents))]


def test_a_group_that_lists_nobody_has_those_for_whom_it_holds_when_its_event_begins() -> None:
    stage = RuleStage({**FENCE, "scope": "group", "at_least": 2, "sustained_seconds": 2})
    inside, outside = (1, 1, 0), (50, 1, 0)
    sent = [
        ("vehicle-07", inside, 1),
        ("vehicle-02", outside, 1.5),
        ("vehicle-05", inside, 2),  # two of them: the event begins at 4
        ("vehicle-09", inside, 3),
        ("vehicle-07", outside, 3.5),
        ("vehicle-01", inside, 5),  # after its begin
        ("vehicle-05", outside, 6),
        ("vehicle-09", outside, 7),
    ]
    edges = [edge for agent, position, at in sent for edge in stage.send(agent, position, at)]
    there = ("vehicle-05", "vehicle-09")
    assert seconds(edges) == [(START, there, 4.0), (STOP, there, 7.0)]
    assert stage.engine.active == ()


def test_a_group_that_lists_nobody_takes_over_its_event_of_before() -> None:
    rule = {**FENCE, "scope": "group", "at_least": 2}
    before = RuleStage(rule)
    edges = [edge for n in (3, 8) for edge in before.send(f"vehicle-0{n}", (1, 1, 0), n)]
    after = RuleStage(rule)
    assert [after.engine.adopt(edge) for edge in edges] == [True]
    assert after.engine.active == tuple(edges)
    again = [edge for n in (4, 6, 8) for edge in after.send(f"vehicle-0{n}", (1, 1, 0), 9 + n / 10)]
    assert again == [], "the event that lasts goes on"
    gone = [edge for n in (4, 6, 8) for edge in after.send(f"vehicle-0{n}", (50, 1, 0), 10 + n / 10)]
    assert [(edge.edge, edge.agents, edge.id) for edge in gone] == [(STOP, edges[0].agents, edges[0].id)]


@pytest.mark.parametrize("moments", [[], [42.5], [41.15, 60]])
def test_a_silent_member_leaves_its_group_when_its_time_is_over_whoever_is_heard_of_next(moments: list[float]) -> None:
    """The two others hold until the second falls: what the silent one did is over long before, though nobody looked."""
    agents = ["vehicle-00", "vehicle-01", "vehicle-02"]
    stage = RuleStage({**HIGH, "scope": "group", "agents": agents, "at_least": 2, "expire_seconds": 30})
    sent = [("vehicle-01", 11, 9), ("vehicle-02", 30, 9), ("vehicle-00", 40, 9), ("vehicle-02", 44, 1),
            ("vehicle-01", 50, 9), ("vehicle-02", 70.5, 9)]  # fmt: skip
    edges = []
    for agent, at, value in sent:
        edges += [edge for moment in moments if moment < at for edge in stage.tick(moment)]
        edges += stage.send(agent, value, at)
    group = tuple(agents)
    expected = [(START, group, 30.0), (STOP, group, 44.0), (START, group, 50.0), (STOP, group, 70.0)]
    assert seconds([*edges, *stage.tick(90)]) == [*expected, (START, group, 70.5), (STOP, group, 80.0)]


def test_members_that_fall_silent_leave_in_the_order_of_their_stamps() -> None:
    """Not of their reception: the later one's message was there earlier."""
    agents = ["vehicle-00", "vehicle-01"]
    stage = RuleStage({**HIGH, "scope": "group", "agents": agents, "at_least": 2, "expire_seconds": 30})
    stage.send("vehicle-00", 9, 10.0, 10.05)
    stage.send("vehicle-01", 9, 10.02, 10.03)
    assert seconds(stage.tick(40.14)) == [(STOP, tuple(agents), 40.0)]
    assert stage.tick(60) == []


def test_who_was_heard_of_last_leaves_last_however_long_he_has_been_there() -> None:
    agents = ["vehicle-00", "vehicle-01"]
    stage = RuleStage({**HIGH, "scope": "group", "agents": agents, "expire_seconds": 2})
    for agent, at in [("vehicle-00", 1), ("vehicle-01", 2), ("vehicle-00", 2.8)]:
        stage.send(agent, 9, at)
    assert seconds(stage.send("vehicle-01", 1, 9)) == [(STOP, tuple(agents), 4.8)]


def test_a_group_that_somebody_leaves_before_its_event_begins_has_none() -> None:
    """By the stamps, although by the times of reception the event would have begun before that."""
    agents = ["vehicle-00", "vehicle-01"]
    stage = RuleStage({**HIGH, "scope": "group", "agents": agents, "at_least": 2, "expire_seconds": 2,
                       "sustained_seconds": 1})  # fmt: skip
    stage.send("vehicle-00", 9, 0.99, 1.05)
    stage.send("vehicle-01", 9, 2.0, 2.0)
    assert stage.tick(3.12) == []
    assert stage.tick(9) == []
