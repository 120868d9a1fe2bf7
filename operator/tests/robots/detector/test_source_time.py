"""Rules and buffers have one time: whatever stamps a source sends, no rule decides on one that the buffer refuses.

Each case goes through `rule test` and through a live detector.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest

from tests.stages.detector.rules import MS, NOW, POSES, SECOND
from tests.stages.detector.streams import Sent, Told, document, lived, replayed

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

Way = Callable[[Sequence[Sent], Mapping[str, Any]], list[Told]]


def by_replay(sent: Sequence[Sent], settings: Mapping[str, Any]) -> list[Told]:
    return replayed(sent, settings)[0]


def by_life(sent: Sequence[Sent], settings: Mapping[str, Any]) -> list[Told]:
    return lived(sent, settings)[0]


ways = pytest.mark.parametrize("way", [by_replay, by_life])


def drive(seconds: int = 20, agents: int = 2) -> list[Sent]:
    """Vehicles at 10 Hz that meet again and again; everything is received as it was measured, 3 ms later."""
    sent = []
    for step in range(seconds * 10):
        for number in range(agents):
            stamp = step * 100 * MS + number * 7 * MS
            x = (1 - 2 * number) * abs(step % 80 - 40) * 1.5
            sent.append(Sent(f"vehicle-{number:02}", stamp, stamp + LATENCY, x))
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
@pytest.mark.parametrize("seed", range(3))
def test_disorder_of_a_second_is_put_in_order(way: Way, seed: int) -> None:
    """The events are those of the same messages in order, but for the first seconds of disorder."""
    settings = document(FAR_EAST, LOST, SLOW)
    edges, expected = (
        [edge for edge in way(sent, settings) if edge.stamp < 60 * SECOND] for sent in (disordered(seed), drive(60, 1))
    )
    assert {edge.rule for edge in edges} == {"east"}
    assert [e for e in edges if e.stamp > 4 * SECOND] == [e for e in expected if e.stamp > 4 * SECOND]


@pytest.mark.parametrize("seed", range(3))
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
