"""Rules and buffers have one time: whatever stamps a source sends, no rule decides on one that the buffer refuses.

Each case goes through `rule test` and through a live detector.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest

from robotkube.robots.rules.core import RuleQuestion
from robotkube.robots.rules.core.plugin_api import Arrival, Holding, PluginHost
from robotkube.robots.rules.core.windows import Window
from tests.stages.detector.rules import MS, NOW, NUMBER, NUMBERS, POSES, SECOND, RuleStage, layouts, number
from tests.stages.detector.streams import ReportedEdge, Sent, document, lived, replayed

NEAR = {"name": "near", "kind": "proximity", "topic": POSES, "start_distance_m": 30, "stop_distance_m": 40}
FAR_EAST = {
    "name": "east", "kind": "threshold", "topic": POSES, "field": "pose.position.x", "start_above": 20,
    "stop_below": 10,
}  # fmt: skip
LOST = {"name": "lost", "kind": "absence", "topic": POSES, "seconds": 0.5}
SLOW = {
    "name": "slow", "kind": "rate", "topic": POSES, "start_below_hz": 8, "stop_above_hz": 9, "window_seconds": 2,
}  # fmt: skip
RULES = document(NEAR, FAR_EAST, LOST, SLOW)
LATENCY = 3 * MS
YEAR_2038 = 2_145_916_800 * SECOND - NOW

Way = Callable[[Sequence[Sent], Mapping[str, Any]], list[ReportedEdge]]


def by_replay(sent: Sequence[Sent], settings: Mapping[str, Any]) -> list[ReportedEdge]:
    return replayed(sent, settings)[0]


def by_life(sent: Sequence[Sent], settings: Mapping[str, Any]) -> list[ReportedEdge]:
    return lived(sent, settings)[0]


ways = pytest.mark.parametrize("way", [by_replay, by_life])


def drive(seconds: int = 20, agents: int = 2) -> list[Sent]:
    """Vehicles at 10 Hz that meet again and again; everything is received as it was measured, 3 ms later."""
    sent = []
    for step in range(seconds * 10):
        for index in range(agents):
            stamp = step * 100 * MS + index * 7 * MS
            x = (1 - 2 * index) * abs(step % 80 - 40) * 1.5
            sent.append(Sent(f"vehicle-{index:02}", stamp, stamp + LATENCY, x))
    return sent


@ways
@pytest.mark.parametrize("ahead", [65 * SECOND, YEAR_2038, -65 * SECOND])
def test_one_stamp_that_is_far_off_changes_no_event(way: Way, ahead: int) -> None:
    """Beside the regular messages, at three moments, near the other vehicle and far from it."""
    plain = drive()
    wrong = [Sent("vehicle-00", at + ahead, at + 50 * MS, x) for at, x in ((3 * SECOND, 0), (8 * SECOND, 900))]
    wrong.append(Sent("vehicle-01", 12 * SECOND + ahead, 12 * SECOND + 55 * MS, 0))
    expected = way(plain, RULES)
    assert {edge.rule for edge in expected} == {"near", "east"}
    assert way([*plain, *wrong], RULES) == expected


@ways
def test_a_regular_message_with_a_wrong_stamp_is_no_absence_and_no_rate(way: Way) -> None:
    """At 10 Hz, with an absence of 0.15 s: the message did come."""
    strict = document({**LOST, "seconds": 0.15}, SLOW)
    plain = drive(agents=1)
    wrong = [m._replace(stamp=YEAR_2038) if m.stamp in (4 * SECOND, 9 * SECOND) else m for m in plain]
    assert way(wrong, strict) == []


@ways
@pytest.mark.parametrize("back", [1_500 * MS, 5 * SECOND, 9 * SECOND, 60 * SECOND])
def test_time_that_jumps_back_blinds_rules_for_a_second_at_most(way: Way, back: int) -> None:
    """No absence is told, since messages come, and an event of the new time begins when its bound is crossed."""
    plain = drive(agents=1)
    jumped = [m._replace(stamp=m.stamp - back if m.stamp >= 11 * SECOND else m.stamp) for m in plain]
    edges = way([m._replace(stamp=m.stamp + 100 * SECOND) for m in jumped], document(FAR_EAST, LOST, SLOW))
    assert {edge.rule for edge in edges} == {"east"}
    crossed = next(m.stamp for m in plain if m.stamp > 13 * SECOND and m.x > 20)
    assert ("start", crossed + 100 * SECOND - back) in {(edge.edge, edge.stamp) for edge in edges}


@ways
def test_time_that_jumps_ahead_is_no_silence(way: Way) -> None:
    plain = drive(agents=1)
    jumped = [m._replace(stamp=m.stamp + (3600 * SECOND if m.stamp >= 10 * SECOND else 0)) for m in plain]
    assert {edge.rule for edge in way(jumped, document(FAR_EAST, LOST, SLOW))} == {"east"}


def disordered(seed: int, seconds: int = 60) -> list[Sent]:
    """One vehicle at 10 Hz, each message up to a second under way."""
    chance = random.Random(seed)  # noqa: S311 - the same cases every time
    return [m._replace(received=m.stamp + chance.randrange(1000) * MS) for m in drive(seconds, 1)]


@ways
@pytest.mark.parametrize("seed", range(2))
def test_disorder_of_a_second_is_put_in_order(way: Way, seed: int) -> None:
    """The events are those of the same messages in order, but for the first seconds of disorder."""
    settings = document(FAR_EAST, LOST, SLOW)
    edges, expected = (
        [edge for edge in way(sent, settings) if edge.stamp < 60 * SECOND] for sent in (disordered(seed), drive(60, 1))
    )
    assert {edge.rule for edge in edges} == {"east"}
    assert [e for e in edges if e.stamp > 4 * SECOND] == [e for e in expected if e.stamp > 4 * SECOND]


@pytest.mark.parametrize("seed", range(2))
def test_few_messages_of_a_disordered_source_are_not_evaluated(seed: int) -> None:
    _, stage = lived(disordered(seed), document(FAR_EAST))
    unseen = stage.detector.unseen.of("/vehicles/vehicle_00/pose")
    assert 0 < unseen["disordered"] < 20
    assert sum(unseen.values()) == unseen["disordered"]


@ways
def test_pairs_are_compared_also_while_one_of_them_is_disordered(way: Way) -> None:
    """The other one waits, so that both are of one time."""
    chance = random.Random(5)  # noqa: S311 - the same cases every time
    plain = drive(60)
    delays = {"vehicle-00": 1, "vehicle-01": 900}
    late = [m._replace(received=m.received + chance.randrange(delays[m.agent]) * MS) for m in plain]
    edges, expected = (way(sent, document(NEAR)) for sent in (late, plain))
    assert [e[:3] for e in edges] == [e[:3] for e in expected]
    assert all(abs(e.stamp - x.stamp) <= 300 * MS for e, x in zip(edges, expected, strict=True))


def test_rules_look_at_once_again_when_a_source_has_kept_its_order() -> None:
    sent = [*disordered(1, 10), *(m for m in drive(60, 1) if m.stamp >= 12 * SECOND)]
    _, stage = lived(sent[:100], document(FAR_EAST))
    assert SECOND / 2 < stage.detector.wait_ns <= 2 * SECOND
    _, stage = lived(sent, document(FAR_EAST))
    assert stage.detector.wait_ns == 0


def test_a_stamp_that_is_not_believed_enters_no_recording_of_an_event() -> None:
    """One whose event lasts would take it in, whenever it was measured."""
    topic = {"name": POSES, "storage": "document", "before_seconds": 2, "after_seconds": 1}
    reaction = {"rule": "near", "kind": "recording", "recording": "r", "volume": "v", "topics": [topic]}
    wrong = Sent("vehicle-00", YEAR_2038, 3 * SECOND + 50 * MS, 0)
    _, stage = lived([*drive(), wrong], {**RULES, "reactions": [reaction]})
    [recordings] = stage.recordings
    assert len(recordings.offered) == 400
    assert NOW + YEAR_2038 not in {stamp for _, stamp in recordings.offered}


def test_the_state_of_a_source_is_told() -> None:
    """Of six vehicles: one as it should be, silent, 5 s ahead, 5 s behind, set back, out of order."""
    chance = random.Random(3)  # noqa: S311 - the same cases every time
    plain = [m for m in drive(12, 6) if m.agent != "vehicle-01" or m.stamp < 2 * SECOND]
    shifts = {"vehicle-02": 5 * SECOND, "vehicle-03": -5 * SECOND}
    sent = []
    for m in plain:
        stamp = m.stamp + 60 * SECOND + shifts.get(m.agent, 0)
        if m.agent == "vehicle-04" and m.stamp > 8 * SECOND:
            stamp -= 900 * SECOND
        late = chance.randrange(300) * MS if m.agent == "vehicle-05" else 0
        sent.append(m._replace(stamp=stamp, received=m.received + 60 * SECOND + late))
    _, stage = lived(sent, document(NEAR))
    topics = stage.status.document()["topics"]
    states = [topics[f"/vehicles/vehicle_0{number}/pose"]["state"] for number in range(6)]
    assert states == ["steady", "silent", "ahead", "behind", "jumped", "disordered"]
    assert round(topics["/vehicles/vehicle_02/pose"]["offset_seconds"], 3) == -4.997
    metrics = stage.status.metrics()
    assert all(f'robotkube_detector_sources{{state="{state}"}} 1\n' in metrics for state in states)
    waited = next(line for line in metrics.splitlines() if line.startswith("robotkube_detector_rules_wait_seconds"))
    assert 0.2 < float(waited.split()[1]) < 0.5


def test_every_message_that_no_rule_saw_is_told_by_its_reason() -> None:
    """In status and metrics, and by `rule test`, which comes to the same numbers."""
    plain = [m._replace(stamp=m.stamp + 60 * SECOND) for m in drive(20, 1)]
    odd = {66 * SECOND: 90 * SECOND, 70 * SECOND: -40 * SECOND, 74 * SECOND: -250 * MS}
    sent = [m._replace(stamp=m.stamp + odd.get(m.stamp, 0)) for m in plain]
    topic = sent[0].topic
    _, result = replayed(sent, RULES)
    assert result.unseen == {topic: {"late": 1, "ahead": 1, "disordered": 1}}
    said = next(problem for problem in result.problems if problem.startswith(topic))
    assert "1 ahead (the stamp is too far ahead to be believed)" in said
    assert not result.incomplete
    _, stage = lived(sent, RULES)
    shown = stage.status.document()
    unseen = shown["topics"][topic]["unseen"]
    assert {reason: count for reason, count in unseen.items() if count} == result.unseen[topic]
    assert shown["rules"]["unseen"] == unseen
    assert {(f'robotkube_detector_unseen_total{{reason="{r}"}} {n}') for r, n in unseen.items()} <= set(
        stage.status.metrics().splitlines()
    )


def test_messages_that_cannot_be_read_wait_or_are_pushed_out_are_told_too() -> None:
    _, stage = lived(drive(2, 1), RULES)
    topic = "/vehicles/vehicle_00/pose"
    source = stage.live.topics[topic]
    source.waiting = [(b"\0\1", stage.now), (Sent("vehicle-00", 3 * SECOND, 0, 1).data[:40], stage.now)]
    source.lost = 5
    stage.detector.turn()
    stage.detector._adopted = False  # the API server has not answered
    stage.detector._adopt_until = 1e9
    stage.send("vehicle-00", 1)
    unseen = stage.detector.unseen.of(topic)
    assert {reason: count for reason, count in unseen.items() if count} == {
        "malformed": 1, "unreadable": 1, "starting": 1, "lost": 5,
    }  # fmt: skip


@ways
def test_a_clock_that_differs_by_five_seconds_raises_nothing_for_pairs(way: Way) -> None:
    sent = [m._replace(stamp=m.stamp + (5 * SECOND if m.agent == "vehicle-01" else 0)) for m in drive()]
    assert way(sent, document(NEAR)) == []


def test_pairs_that_are_not_compared_because_of_their_clocks_are_told() -> None:
    sent = [m._replace(stamp=m.stamp + (5 * SECOND if m.agent == "vehicle-01" else 0)) for m in drive()]
    _, result = replayed(sent, document(NEAR))
    [apart] = result.apart
    assert (apart["rule"], apart["agents"]) == ("near", ["vehicle-00", "vehicle-01"])
    assert apart["count"] > 50
    assert abs(apart["seconds"] - 5) < 0.2
    assert any("did not compare vehicle-00 and vehicle-01" in problem for problem in result.problems)
    _, stage = lived(sent, document(NEAR))
    assert stage.status.document()["rules"]["apart"][0]["count"] == apart["count"]
    assert f'robotkube_detector_rule_apart_total{{rule="near"}} {apart["count"]}\n' in stage.status.metrics()


def test_an_agent_that_is_silent_is_not_said_to_have_a_wrong_clock() -> None:
    sent = [m for m in drive() if m.agent == "vehicle-00" or m.stamp < 5 * SECOND]
    assert replayed(sent, document(NEAR))[1].apart == []


def test_a_pair_expression_tells_it_as_well() -> None:
    rule = {"name": "apart", "kind": "cel", "scope": "pair", "topic": NUMBERS, "fields": {"v": "data"},
            "agents": ["vehicle-00", "vehicle-01"], "expression": "a.v > b.v"}  # fmt: skip
    stage = RuleStage(rule, ask=lambda question: None)
    stage.send("vehicle-00", 1, 5, 1)
    stage.send("vehicle-01", 1, 1, 1)
    assert stage.engine.apart["apart"].seconds() == {("vehicle-00", "vehicle-01"): (1, 4.0)}


def test_a_plugin_sees_what_it_is_asked_about_whatever_its_own_window_is() -> None:
    """The topic's clock has judged the stamp by the topic's buffer, which may be longer; it is not judged again."""
    topic = "/vehicles/vehicle_00/value"
    seen: list[tuple[int, int]] = []

    class Latest:
        def evaluate(self, arrival: Arrival, window: Window) -> list[Holding]:
            latest = window.latest(topic, ["data"])
            assert latest is not None
            seen.append((arrival.stamp, latest.stamp))
            return []

    host = PluginHost(Latest(), {NUMBERS: NUMBER}, layouts(), 2.0)
    stamps = [NOW + at * SECOND for at in (0, 5, 6, -900, -899)]
    for step, stamp in enumerate(stamps):
        data = number(step)
        host.answer(RuleQuestion("r", ("vehicle-00",), topic, stamp, NOW + step * MS, type=NUMBER, data=data))
    assert seen == [(stamp, stamp) for stamp in stamps]
