"""Rules: what begins and ends an event, one kind and one common key after the other."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from robotkube.robots.rules.core import START, STOP, Edge, Message, Rule, RuleEngine, event_identity, reason, task_name
from robotkube.robots.rules.core.conditions.external import AnsweredQuestion, RuleAnswer, RuleQuestion
from robotkube.robots.rules.core.messages import FALL, KEEP, RISE
from tests.stages.detector.rules import (
    MS,
    NOW,
    NUMBER,
    NUMBERS,
    POSE,
    POSES,
    SECOND,
    TEXT,
    RuleStage,
    layouts,
    number,
    pose,
    read,
    seconds,
)

NEAR: dict[str, Any] = {
    "name": "near", "kind": "proximity", "agents": ["vehicle-00", "vehicle-01", "vehicle-02"], "topic": POSES,
    "start_distance_m": 400, "stop_distance_m": 500,
}  # fmt: skip
HIGH: dict[str, Any] = {
    "name": "high", "kind": "threshold", "topic": NUMBERS, "field": "data", "start_above": 5, "stop_below": 3,
}  # fmt: skip
FENCE: dict[str, Any] = {
    "name": "yard", "kind": "geofence", "topic": POSES,
    "area": {
        "type": "Polygon",
        "coordinates": [[[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]], [[4, 4], [6, 4], [6, 6], [4, 6]]],
    },
}  # fmt: skip


def test_the_edge_carries_the_triggering_pose_and_its_causes() -> None:
    stage = RuleStage(NEAR)
    assert not stage.send("vehicle-01", (0, 0, 0), 0.005, 0.011)
    assert not stage.send("vehicle-00", (300, 300, 0), 0.006, 0.012)
    [edge] = stage.send("vehicle-00", (300, 200, 100), 0.007, 0.013)
    assert (edge.stamp, edge.time, edge.agents) == (NOW + 7 * MS, NOW + 13 * MS, ("vehicle-00", "vehicle-01"))
    assert edge.distance_m == (300**2 + 200**2 + 100**2) ** 0.5
    assert (edge.id, edge.trace) == event_identity("near", edge.agents, NOW + 7 * MS)
    assert (len(edge.id), len(edge.trace)) == (16, 32)
    assert [(cause.topic, cause.stamp - NOW, cause.values["pose.position.x"]) for cause in edge.causes] == [
        ("/vehicles/vehicle_00/pose", 7 * MS, 300.0),
        ("/vehicles/vehicle_01/pose", 5 * MS, 0.0),
    ]


def test_between_the_distances_nothing_happens() -> None:
    stage = RuleStage(NEAR)
    stage.send("vehicle-00", (0, 0, 0), 0)
    assert stage.send("vehicle-01", (399, 0, 0), 0.1)
    for step, x in enumerate([450.0, 500.0, 399.0, 499.0, 400.0]):
        assert not stage.send("vehicle-01", (x, 0, 0), 0.2 + step / 10)
    assert [edge.edge for edge in stage.send("vehicle-01", (500.5, 0, 0), 0.8)] == [STOP]
    assert not stage.send("vehicle-01", (450, 0, 0), 0.9)


@pytest.mark.parametrize("far", [1e13, 1e200, 1.7e308])
def test_whoever_is_very_far_away_is_not_near_any_more(far: float) -> None:
    """Such a position was taken for none, and the event went on for ever."""
    stage = RuleStage({**NEAR, "start_distance_m": 0.1})
    stage.send("vehicle-00", (0, 0, 0), 0)
    assert [edge.edge for edge in stage.send("vehicle-01", (0, 0, 0), 0.1)] == [START]
    [edge] = stage.send("vehicle-01", (far, -far, 0), 0.2)
    assert edge.edge == STOP
    assert math.isfinite(edge.distance_m or math.inf)
    assert stage.engine.counts.unseen.totals["no_number"] == 0
    assert [edge.edge for edge in stage.send("vehicle-00", (far, -far, 0), 0.3)] == [START], "both are there"


@pytest.mark.parametrize("begin", [0, -100 * SECOND, -(2**31) * SECOND])
def test_stamps_before_1970_are_stamps(begin: int) -> None:
    """Events began and ended at the stamp -1, the later of it and theirs."""
    stage = RuleStage(HIGH, begin=begin)
    edges = [edge for at, value in enumerate((1, 9, 9, 1)) for edge in stage.send("vehicle-00", value, at)]
    assert seconds(edges, begin) == [(START, ("vehicle-00",), 1.0), (STOP, ("vehicle-00",), 3.0)]


def test_other_agents_and_stale_poses_are_not_compared() -> None:
    stage = RuleStage(NEAR)
    stage.send("vehicle-00", (0, 0, 0), 0)
    assert not stage.send("vehicle-99", (1, 0, 0), 0)
    assert not stage.send("vehicle-01", (1, 0, 0), 1.001)
    assert stage.send("vehicle-00", (0, 0, 0), 1.002)


def test_who_falls_silent_has_no_event_any_more() -> None:
    by_time, by_message = RuleStage({**NEAR, "expire_seconds": 5}), RuleStage({**NEAR, "expire_seconds": 5})
    for stage in (by_time, by_message):
        stage.send("vehicle-00", (0, 0, 0), 1)
        assert stage.send("vehicle-01", (10, 0, 0), 1.5)
        for second in range(2, 6):
            assert not stage.send("vehicle-01", (10, 0, 0), second)
    assert by_time.tick(6.05) == []
    [stop] = by_time.tick(6.2)
    [same, *_] = by_message.send("vehicle-00", (10, 0, 0), 9)
    assert seconds([stop]) == seconds([same]) == [(STOP, ("vehicle-00", "vehicle-01"), 6.0)]
    assert stop.id == same.id
    assert by_time.engine.active == ()


def test_a_late_message_is_counted_and_not_evaluated() -> None:
    stage = RuleStage(HIGH)
    stage.send("vehicle-00", 1, 1)
    assert not stage.send("vehicle-00", 9, 0.9)
    assert stage.engine.counts.unseen.totals["disordered"] == 1
    assert stage.send("vehicle-00", 9, 1), "the same stamp again is no late one"


def test_time_that_begins_anew_is_followed() -> None:
    """A simulation that starts over: when the topic's clock has said so, the old time counts no more."""
    stage = RuleStage({**HIGH, "cooldown_seconds": 30})
    assert stage.send("vehicle-00", 9, 1000)
    assert stage.send("vehicle-00", 1, 1001)
    assert not stage.send("vehicle-00", 9, 5)
    stage.engine.restart("/vehicles/vehicle_00/value", NOW + 5 * SECOND)
    assert seconds(stage.send("vehicle-00", 9, 5.1)) == [(START, ("vehicle-00",), 5.1)]


def test_a_message_without_a_credible_stamp_is_a_sign_of_life() -> None:
    """It puts an absence off, by the clock of reception; so does one that is older than the last one."""
    stage = RuleStage({"name": "lost", "kind": "absence", "topic": NUMBERS, "seconds": 2})
    stage.send("vehicle-00", 1, 1)
    stage.engine.overlook("/vehicles/vehicle_00/value", NOW + 2 * SECOND)
    assert stage.tick(3.5) == []
    stage.send("vehicle-00", 1, 0.5, 3.6)
    assert stage.tick(5.6) == []
    assert seconds(stage.tick(5.8)) == [(START, ("vehicle-00",), 5.6)]


def test_a_rate_counts_messages_that_come_late() -> None:
    stage = RuleStage({"name": "slow", "kind": "rate", "topic": NUMBERS, "start_below_hz": 8, "stop_above_hz": 9,
                       "window_seconds": 2})  # fmt: skip
    order = [step ^ 1 for step in range(100)]  # each two in the wrong order
    assert [edge for step in order for edge in stage.send("vehicle-00", 1, step / 10)] == []
    assert stage.engine.counts.unseen.of("/vehicles/vehicle_00/value")["disordered"] == 50


@pytest.mark.parametrize(
    ("above", "values", "edges"),
    [
        (True, [0.1, 0.15, 0.16, 0.12, 0.1, 0.09, 0.12, 0.2], [(2, START), (5, STOP), (7, START)]),
        (False, [0.2, 0.15, 0.14, 0.19, 0.2, 0.21, 0.16, 0.1], [(2, START), (5, STOP), (7, START)]),
    ],
)
def test_a_threshold_has_a_start_and_a_stop(above: bool, values: list[float], edges: list[tuple[int, str]]) -> None:
    keys = {"start_above": 0.15, "stop_below": 0.1} if above else {"start_below": 0.15, "stop_above": 0.2}
    stage = RuleStage({key: value for key, value in HIGH.items() if not key.startswith("st")} | keys)
    numbered = [(n, edge) for n, value in enumerate(values) for edge in stage.send("vehicle-00", value, n)]
    assert [(n, edge.edge) for n, edge in numbered] == edges
    assert numbered[0][1].id == numbered[1][1].id != numbered[2][1].id
    assert numbered[0][1].detail == {"data": values[2]}


def test_agents_of_a_pattern_have_events_of_their_own_and_a_topic_without_agent_is_the_detectors() -> None:
    stage = RuleStage(HIGH, {**HIGH, "name": "own", "topic": "/value"})
    edges = [edge for agent in ("vehicle-00", "vehicle-01") for edge in stage.send(agent, 9, 1)]
    assert [edge.agents for edge in edges] == [("vehicle-00",), ("vehicle-01",)]
    [own] = stage.engine.observe(Message("/value", NUMBER, NOW, NOW, number(9)))
    assert (own.rule, own.agents) == ("own", ("cloud-0",))
    assert len(stage.engine.active) == 3


def test_a_geofence_with_a_hole_and_a_margin() -> None:
    stage = RuleStage({**FENCE, "margin": 1})
    path = [(-5, 5), (1, 5), (3.5, 5), (4.5, 5), (5, 5), (7, 5), (10.5, 5), (11.5, 5)]
    edges = [
        (step, edge.edge) for step, (x, y) in enumerate(path) for edge in stage.send("vehicle-00", (x, y, 0), step)
    ]
    assert edges == [(1, START), (7, STOP)], "the middle of the hole is 1 m from its edge"
    outside = RuleStage({**FENCE, "when": "outside"})
    assert outside.send("vehicle-00", (5, 5, 0), 1), "in the hole is outside"
    assert [edge.edge for edge in outside.send("vehicle-00", (4, 5, 0), 2)] == [STOP], "on its edge is inside"


def test_a_message_that_cannot_be_compared_does_not_hide_what_ended_before_it() -> None:
    stage = RuleStage({**FENCE, "expire_seconds": 30})
    stage.send("vehicle-00", (5, 1, 0), 1)
    assert seconds(stage.send("vehicle-00", (math.nan, 0, 0), 50)) == [(STOP, ("vehicle-00",), 31.0)]
    assert stage.engine.active == ()


@pytest.mark.parametrize("rule", [HIGH | {"topic": POSES, "field": "pose.position.x"}, FENCE, NEAR])
def test_a_number_that_is_none_is_counted_and_no_problem(rule: dict[str, Any]) -> None:
    stage = RuleStage(rule)
    stage.send("vehicle-00", (math.nan, 0, 0), 1)
    counts = stage.engine.counts
    assert (counts.unseen.totals["no_number"], counts.malformed, stage.engine.problems) == (1, {}, {})


def test_every_so_often_only_the_first_message_of_a_span_is_looked_at() -> None:
    stage = RuleStage({**HIGH, "every_seconds": 1})
    edges = [(at, edge.edge) for at, value in [(0, 1), (0.5, 9), (1.1, 9), (1.5, 1), (2.3, 1)]
             for edge in stage.send("vehicle-00", value, at)]  # fmt: skip
    assert edges == [(1.1, START), (2.3, STOP)]


def test_agents_that_are_expected_are_missed_from_the_begin() -> None:
    stage = RuleStage({"name": "lost", "kind": "absence", "topic": NUMBERS, "seconds": 2, "agents": ["vehicle-00"]})
    assert stage.tick(0) == []
    assert seconds(stage.tick(2.5)) == [(START, ("vehicle-00",), 2.0)]
    assert seconds(stage.send("vehicle-00", 1, 3)) == [(STOP, ("vehicle-00",), 3.0)]


def test_too_fast_and_too_slow() -> None:
    fast = RuleStage({"name": "fast", "kind": "rate", "topic": NUMBERS, "start_above_hz": 15, "stop_below_hz": 11,
                      "window_seconds": 1})  # fmt: skip
    edges = [edge for step in range(20) for edge in fast.send("vehicle-00", 1, step / 10)]
    assert edges == []
    edges = [edge for step in range(40) for edge in fast.send("vehicle-00", 1, 2 + step / 20)]
    assert [edge.edge for edge in edges] == [START]
    assert edges[0].detail["hz"] == 16
    assert [edge.edge for edge in fast.tick(5)] == [STOP]


def combination(**keys: Any) -> tuple[dict[str, Any], ...]:
    """Near and high, silent, and a combination of both."""
    near = {key: value for key, value in NEAR.items() if key != "agents"}
    return {**near, "silent": True}, {**HIGH, "silent": True}, {"name": "both", "kind": "combination", **keys}


def test_all_of_a_pair_and_one_of_its_agents() -> None:
    stage = RuleStage(*combination(all=["near", "high"], scope="pair"))
    stage.send("vehicle-00", (0, 0, 0), 0)
    assert stage.send("vehicle-01", (1, 0, 0), 0.1) == []
    assert stage.send("vehicle-02", 9, 0.2) == [], "not one of the two"
    [start] = stage.send("vehicle-01", 9, 0.3)
    assert (start.rule, start.agents) == ("both", ("vehicle-00", "vehicle-01"))
    assert {cause.topic for cause in start.causes} == {
        "/vehicles/vehicle_01/value", "/vehicles/vehicle_00/pose", "/vehicles/vehicle_01/pose",
    }  # fmt: skip
    assert [edge.edge for edge in stage.send("vehicle-01", (900, 0, 0), 0.4)] == [STOP]


def test_any_and_not() -> None:
    stage = RuleStage(*combination(any=["near", "high"]))
    assert seconds(stage.send("vehicle-00", 9, 1)) == [(START, ("vehicle-00",), 1.0)]
    stage.send("vehicle-00", (0, 0, 0), 2)
    assert seconds(stage.send("vehicle-01", (1, 0, 0), 2.5)) == [(START, ("vehicle-01",), 2.5)]
    assert stage.send("vehicle-00", 1, 2.6) == [], "it is still near somebody"
    negated = RuleStage(*combination(**{"all": ["near", {"not": "high"}]}))
    negated.send("vehicle-00", (0, 0, 0), 1)
    assert len(negated.send("vehicle-01", (1, 0, 0), 1.5)) == 2
    assert seconds(negated.send("vehicle-00", 9, 2)) == [(STOP, ("vehicle-00",), 2.0)]
    calm = RuleStage(HIGH, {"name": "calm", "kind": "combination", "not": "high", "agents": ["vehicle-00"]})
    assert [(edge.rule, edge.edge) for edge in calm.tick(0)] == [("calm", START)]
    assert sorted((e.rule, e.edge) for e in calm.send("vehicle-00", 9, 1)) == [("calm", STOP), ("high", START)]


def test_a_negation_of_a_negation_begins_with_what_its_part_says() -> None:
    """It began before its part had said that it holds, and ended at the same stamp."""
    low: dict[str, Any] = {"name": "low", "kind": "combination", "not": "high", "agents": ["vehicle-00"]}
    stage = RuleStage(HIGH, {**low, "name": "raised", "not": "low"}, low)
    assert [(edge.rule, edge.edge) for edge in stage.tick(0)] == [("low", START)]
    assert {(e.rule, e.edge) for e in stage.send("vehicle-00", 9, 1)} == {
        ("high", START), ("low", STOP), ("raised", START),
    }  # fmt: skip


def test_a_new_combination_begins_with_all_that_its_parts_say() -> None:
    """Both parts last since before it was there; one after the other, the first of them alone began an event."""
    much = {**HIGH, "name": "much", "topic": POSES, "field": "pose.position.x"}
    stage = RuleStage(HIGH, much)
    stage.send("vehicle-00", 9, 1)
    stage.send("vehicle-00", (9, 0, 0), 2)
    only = {"name": "only", "kind": "combination", "all": ["high", {"not": "much"}]}
    stage.engine.replace(read(HIGH, much, only), NOW + 3 * SECOND)
    assert stage.tick(3) == []
    assert [(e.rule, e.edge) for e in stage.send("vehicle-00", (1, 0, 0), 4)] == [("much", STOP), ("only", START)]


def test_a_message_that_changes_two_parts_shows_nothing_in_between() -> None:
    def above(name: str, value: float) -> dict[str, Any]:
        bounds = {"start_above": value, "stop_below": value}
        return {"name": name, "kind": "threshold", "topic": NUMBERS, "field": "data", "silent": True, **bounds}

    stage = RuleStage(
        above("some", 3), above("much", 6),
        {"name": "middle", "kind": "combination", "all": ["some", {"not": "much"}]},
    )  # fmt: skip
    edges = [edge for at, value in enumerate((1, 7, 1, 4, 7, 4, 1)) for edge in stage.send("vehicle-00", value, at)]
    assert [(edge, at) for edge, _, at in seconds(edges)] == [(START, 3.0), (STOP, 4.0), (START, 5.0), (STOP, 6.0)]


def test_combinations_that_share_their_parts_are_built_at_once() -> None:
    """Two rules a layer, each of both below: by way of the last there are 2^40 ways to the first."""
    layers: list[dict[str, Any]] = [
        {"name": f"{name}0", "kind": "absence", "topic": NUMBERS, "seconds": 1, "agents": ["vehicle-00"]}
        for name in "ab"
    ]
    for level in range(1, 40):
        parts = [f"a{level - 1}", f"b{level - 1}"]
        for name, mode in (("a", "all"), ("b", "any")):
            layers.append({"name": f"{name}{level}", "kind": "combination", mode: parts})
    stage = RuleStage(*layers)
    stage.tick(0)
    assert len(stage.tick(5)) == len(layers)


def test_always_holds_from_the_first_moment() -> None:
    stage = RuleStage({"name": "ever", "kind": "always"})
    [edge] = stage.tick(1)
    assert (edge.edge, edge.agents, edge.stamp) == (START, ("cloud-0",), NOW + SECOND)
    assert stage.tick(2) == []


def test_adopted_events_end_and_are_not_raised_again() -> None:
    stage = RuleStage({**NEAR, "expire_seconds": 5})
    edge = Edge("near", START, ("vehicle-00", "vehicle-01"), "a" * 16, "b" * 32, NOW, NOW)
    assert stage.engine.adopt(edge)
    assert not stage.engine.adopt(replace(edge, id="c" * 16)), "a pair has one event"
    assert not stage.engine.adopt(replace(edge, agents=("vehicle-00", "vehicle-77")))
    assert not stage.engine.adopt(replace(edge, rule="other"))
    stage.send("vehicle-00", (0, 0, 0), 0.1)
    assert not stage.send("vehicle-01", (10, 0, 0), 0.2)
    [stop] = stage.send("vehicle-01", (600, 0, 0), 0.3)
    assert (stop.edge, stop.id, stop.trace) == (STOP, "a" * 16, "b" * 32)
    silent = RuleStage({**NEAR, "expire_seconds": 5})
    silent.engine.adopt(edge)
    assert silent.tick(100) == []
    assert [ended.id for ended in silent.tick(105.2)] == ["a" * 16], "nobody came back"


def test_an_adopted_part_counts_for_its_combination() -> None:
    documents = combination(all=["near", "high"], scope="pair")
    stage = RuleStage(*documents)
    pair = ("vehicle-00", "vehicle-01")
    assert stage.engine.adopt(Edge("near", START, pair, "a" * 16, "b" * 32, NOW, NOW))
    assert stage.engine.adopt(Edge("both", START, pair, "c" * 16, "d" * 32, NOW, NOW))
    assert stage.tick(0) == []
    assert stage.send("vehicle-01", 9, 0.5) == [], "it goes on"
    stage.send("vehicle-00", (0, 0, 0), 1)
    [stop] = stage.send("vehicle-01", (600, 0, 0), 1)
    assert (stop.rule, stop.id) == ("both", "c" * 16)


def test_an_adopted_combination_whose_parts_do_not_come_back_ends() -> None:
    stage = RuleStage(*combination(all=["near", "high"], scope="pair"))
    assert stage.engine.adopt(Edge("both", START, ("vehicle-00", "vehicle-01"), "c" * 16, "d" * 32, NOW, NOW))
    assert stage.tick(0) == stage.tick(59) == []
    assert [(edge.edge, edge.id) for edge in stage.tick(61)] == [(STOP, "c" * 16)]


def test_changed_rules_take_over_what_they_can() -> None:
    stage = RuleStage(NEAR, HIGH)
    stage.send("vehicle-00", (0, 0, 0), 0)
    [near] = stage.send("vehicle-01", (10, 0, 0), 0)
    [high] = stage.send("vehicle-02", 9, 0)
    kept, ended = stage.engine.replace(read({**NEAR, "stop_distance_m": 900}), NOW + SECOND)
    assert kept == [near]
    assert [(edge.id, edge.edge, edge.stamp) for edge in ended] == [(high.id, STOP, NOW + SECOND)]
    stage.send("vehicle-00", (0, 0, 0), 1)
    assert stage.send("vehicle-01", (800, 0, 0), 1) == []
    assert [edge.id for edge in stage.send("vehicle-01", (901, 0, 0), 1.1)] == [near.id]


def test_unchanged_rules_keep_all_they_know() -> None:
    stage = RuleStage(HIGH, {**NEAR, "name": "old"})
    stage.send("vehicle-00", (0, 0, 0), 0)
    stage.engine.replace(read({**NEAR, "name": "old"}), NOW)
    assert [edge.rule for edge in stage.send("vehicle-01", (10, 0, 0), 0.1)] == ["old"]


def test_a_message_that_cannot_be_read_is_counted_and_spoils_nothing() -> None:
    stage = RuleStage(HIGH, {"name": "lost", "kind": "absence", "topic": NUMBERS, "seconds": 1})
    topic = "/vehicles/vehicle_00/value"
    assert stage.engine.observe(Message(topic, NUMBER, NOW, NOW, b"\0\1\0\0\1")) == []
    assert stage.engine.observe(Message(topic, TEXT, NOW, NOW, number(9))) == []
    assert stage.engine.counts.malformed[topic] == 2
    assert stage.send("vehicle-00", 9, 0.5)


def test_answers_from_elsewhere_become_events() -> None:
    asked: list[RuleQuestion] = []
    rule = {"name": "fast", "kind": "cel", "topic": NUMBERS, "fields": {"v": "data"}, "expression": "v > 1.0",
            "cooldown_seconds": 1, "expire_seconds": 10}  # fmt: skip
    stage = RuleStage(rule, ask=asked.append)
    assert stage.send("vehicle-00", 2, 1) == []
    [question] = asked
    assert (question.rule, question.values) == ("fast", {"v": 2.0, "agent": "vehicle-00"})

    def answer(verdict: int, at: float) -> list[Edge]:
        stamp = NOW + round(at * SECOND)
        asked_for = question._replace(stamp=stamp, received=stamp)
        return stage.engine.answer(AnsweredQuestion(asked_for, [RuleAnswer(question.member, verdict)]))

    steps = [(RISE, 1), (RISE, 2), (KEEP, 3), (FALL, 4), (RISE, 4.5), (RISE, 5.2)]
    edges = [edge[::2] for verdict, at in steps for edge in seconds(answer(verdict, at))]
    assert edges == [(START, 1.0), (STOP, 4.0), (START, 5.0)]
    assert [edge[::2] for edge in seconds(stage.tick(16))] == [(STOP, 15.2)], "its process answers no more"


def test_a_pair_expression_gets_both_agents() -> None:
    asked: list[RuleQuestion] = []
    rule = {"name": "apart", "kind": "cel", "scope": "pair", "topic": NUMBERS, "fields": {"v": "data"},
            "agents": ["vehicle-00", "vehicle-01"], "expression": "a.v > b.v"}  # fmt: skip
    stage = RuleStage(rule, ask=asked.append)
    stage.send("vehicle-01", 1, 0)
    stage.send("vehicle-00", 2, 5)
    assert asked == [], "too far apart"
    stage.send("vehicle-01", 3, 5.5)
    [question] = asked
    assert question.member == ("vehicle-00", "vehicle-01")
    assert question.values == {"a": {"v": 2.0, "agent": "vehicle-00"}, "b": {"v": 3.0, "agent": "vehicle-01"}}


def test_what_is_read_and_when_something_is_due() -> None:
    stage = RuleStage(NEAR, HIGH, {**HIGH, "name": "late", "sustained_seconds": 3})
    assert dict(stage.engine.topics_read) == {
        POSES: ("pose.position.x", "pose.position.y", "pose.position.z"), NUMBERS: ("data",),
    }  # fmt: skip
    stage.tick(0)
    stage.send("vehicle-00", 9, 1)
    due = stage.engine.due()
    assert due is not None
    assert 4 * SECOND <= due - NOW <= 4.2 * SECOND
    assert [edge.rule for edge in stage.engine.tick(due)] == ["late"]


def test_reasons_are_words() -> None:
    rules = [*read(NEAR, HIGH, FENCE), *read(*combination(all=["near", {"not": "high"}]))[2:]]
    assert [reason(rule) for rule in rules] == [
        "{agents} within 400 m", "{agents}: data above 5", "{agents} inside yard", "{agents}: near and not high",
    ]  # fmt: skip


def test_task_names_are_object_names() -> None:
    edge = Edge("Lidar_Proximity", START, ("vehicle-00", "vehicle-01"), "3f2a9c0011223344", "t" * 32, 1, 1)
    assert task_name(edge) == "lidar-proximity-vehicle-00-vehicle-01-3f2a9c"
    long = task_name(replace(edge, rule="x" * 80))
    assert len(long) <= 63
    assert long.endswith("-3f2a9c")


def test_the_order_of_two_agents_messages_does_not_change_the_event() -> None:
    """Equal stamps, either first: the same id."""
    edges = []
    for agents in (("vehicle-00", "vehicle-01"), ("vehicle-01", "vehicle-00")):
        stage = RuleStage(NEAR)
        places = {"vehicle-00": (0, 0, 0), "vehicle-01": (100, 0, 0)}
        edges += [edge.id for agent in agents for edge in stage.send(agent, places[agent], 1)]
    assert len(edges) == 2
    assert edges[0] == edges[1]


def test_a_thousand_agents_cost_a_fraction_of_a_core() -> None:
    """Not a measurement: the grid looks at neighbours only, so that the work does not grow with the agents."""
    rules: tuple[Rule, ...] = read({**{k: v for k, v in NEAR.items() if k != "agents"}, "start_distance_m": 10})
    engine = RuleEngine(rules, layouts(), "cloud-0")
    for agent in range(1000):
        x = float(agent % 32) * 25
        edges = engine.observe(Message(f"/vehicles/v{agent}/pose", POSE, NOW, NOW, pose(x, agent // 32 * 25)))
        assert edges == []
    assert [edge.agents for edge in engine.observe(Message("/vehicles/v0/pose", POSE, NOW + 1, NOW, pose(20)))] == [
        ("v0", "v1")
    ]
