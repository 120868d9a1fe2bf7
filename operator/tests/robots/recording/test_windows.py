"""Recordings around events: what they keep, which events share one, and that nothing is kept twice."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.recording.core.audits import add_up, holes
from robotkube.robots.recording.core.plans import FOREVER, RecordedTopic, RecordingPlan, Windows
from robotkube.robots.recording.loops.destinations import RecorderPlace
from robotkube.robots.recording.loops.journal import Journal, Listener
from robotkube.robots.recording.loops.recordings import LINGER_SECONDS, Recordings
from robotkube.robots.ros.core.ring_buffers import BufferBounds, RingBuffer, Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.testing.recordings import RecordingDatabase, RecordingVolume
from tests.stages.waiting import until

SECOND, MS = 1_000_000_000, 1_000_000
BEGIN = 1_795_250_000 * SECOND
POSE = RecordedTopic(TopicPattern("/vehicles/{agent}/pose"), "p", "document", before_seconds=2, after_seconds=1)
CLOUD = RecordedTopic(TopicPattern("/cloud"), "c", "segment", before_seconds=0.5, after_seconds=0.5)
STATIC = RecordedTopic(TopicPattern("/tf_static"), "t", "document", latched=True)
PLAN = RecordingPlan(
    "near", "encounter", "recordings", (POSE, CLOUD, STATIC), always=False, provenance={"chart": "detector@sha256:1"}
)
HOLES_MAX = 18  # of 200 stamps; each makes one distance uneven, and nine of ten have to be even
A, B, C = "/vehicles/a/pose", "/cloud", "/tf_static"


@dataclass(frozen=True)
class Event:
    """An edge, as far as recordings care."""

    id: str
    stamp: int
    rule: str = "near"
    agents: tuple[str, ...] = ("a", "b")
    trace: str = "trace"
    time: int = 0


class Bench:
    """Recordings with buffers; time is in tenths of seconds."""

    def __init__(self) -> None:
        self.database = RecordingDatabase()
        self.volume = RecordingVolume()
        self.buffers = {
            A: RingBuffer(BufferBounds(10, 10**6)),
            B: RingBuffer(BufferBounds(10, 10**6)),
            C: RingBuffer(BufferBounds(10, 10**6), latched=True),
        }
        place = RecorderPlace("n/c", lambda: self.database, lambda: self.volume, lambda: BEGIN, time.monotonic)
        self.definitions: dict[str, str] = {}
        self.recordings = Recordings(PLAN, place, self.buffers, carried=lambda name: self.definitions.get(name, ""))
        self.recordings.start()
        self.tenth = 0

    @property
    def now(self) -> int:
        return BEGIN + self.tenth * 100 * MS

    def play(self, tenths: int) -> None:
        """A pose and a cloud every tenth of a second; the static transform comes once, at the begin."""
        for _ in range(tenths):
            for topic in (A, B) if self.tenth else (A, B, C):
                sample = Sample(self.now, self.now, f"{topic} {self.tenth}".encode())
                self.buffers[topic].insert(sample)
                self.recordings.offer(topic, "x", sample)
            self.recordings.tick(self.now)
            self.tenth += 1

    def kept(self, recording: str) -> dict[str, list[int]]:
        """Topic -> tenths that are stored."""
        stamps: dict[str, list[int]] = {}
        for topic, stamp, _ in self.database.known(recording):
            stamps.setdefault(topic, []).append((stamp - BEGIN) // (100 * MS))
        return {topic: sorted(tenths) for topic, tenths in stamps.items()}

    def ended(self, recording: str) -> bool:
        return any(one["_id"] == recording and one["ended"] for one in self.database.recordings())

    def document(self, recording: str) -> dict[str, Any]:
        return self.database.collections["recordings"][recording]


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    until(lambda: bench.recordings.ready)
    yield bench
    bench.recordings.stop(5.0)


def test_a_recording_has_what_came_before_and_after_its_event(bench: Bench) -> None:
    bench.play(50)
    bench.recordings.trigger(Event("0123456789ab", BEGIN + 40 * 100 * MS), bench.now)
    bench.recordings.trigger(Event("0123456789ab", BEGIN + 40 * 100 * MS), bench.now)
    bench.play(20)
    bench.recordings.end(Event("0123456789ab", bench.now), bench.now)
    bench.play(int((LINGER_SECONDS + 2) * 10))
    until(lambda: bench.ended("encounter-01234567"))
    assert bench.kept("encounter-01234567") == {A: list(range(20, 81)), B: list(range(35, 76)), C: [0]}
    document = bench.document("encounter-01234567")
    assert document["provenance"] == {
        "rule": "near", "event": "0123456789ab", "trace": "trace", "chart": "detector@sha256:1",
    }  # fmt: skip
    audits = add_up(bench.database.audits("encounter-01234567"))
    assert {topic: (audit.received, audit.stored, audit.gaps) for topic, audit in audits.items()} == {
        A: (61, 61, ()), B: (41, 41, ()), C: (1, 1, ()),
    }  # fmt: skip


def test_definitions_that_came_with_the_messages_are_kept_also_when_they_come_late(bench: Bench) -> None:
    bench.play(10)
    bench.recordings.trigger(Event("0123456789ab", bench.now), bench.now)
    bench.play(5)
    until(lambda: "encounter-01234567" in bench.database.collections.get("recordings", {}))
    assert "definitions" not in bench.document("encounter-01234567")
    bench.definitions = {"p": "float64 height", "other": "float64 width"}
    bench.recordings.end(Event("0123456789ab", bench.now), bench.now)
    bench.play(int((LINGER_SECONDS + 2) * 10))
    until(lambda: bench.ended("encounter-01234567"))
    assert bench.document("encounter-01234567")["definitions"] == {"p": "float64 height"}
    bench.recordings.trigger(Event("123456789abc", bench.now), bench.now)
    bench.play(5)
    until(lambda: "encounter-12345678" in bench.database.collections["recordings"])
    assert bench.document("encounter-12345678")["definitions"] == {"p": "float64 height"}


def test_events_whose_windows_overlap_share_a_recording_with_both_as_causes(bench: Bench) -> None:
    first, second, third = (Event(f"{n}" * 12, BEGIN + tenth * 100 * MS) for n, tenth in enumerate((30, 55, 150)))
    bench.play(31)
    bench.recordings.trigger(first, bench.now)
    bench.play(9)
    bench.recordings.end(replace(first, stamp=bench.now), bench.now)
    bench.play(16)
    bench.recordings.trigger(second, bench.now)
    bench.play(10)
    bench.recordings.end(replace(second, stamp=bench.now), bench.now)
    bench.play(85)
    bench.recordings.trigger(third, bench.now)
    assert bench.recordings.stop(5.0)
    causes = [(cause["event"], cause["stopped"]) for cause in bench.document("encounter-00000000")["causes"]]
    assert causes == [("0" * 12, BEGIN + 40 * 100 * MS), ("1" * 12, BEGIN + 66 * 100 * MS)]
    kept = bench.kept("encounter-00000000")
    assert kept[A] == list(range(10, 77))
    assert kept[B] == [*range(25, 46), *range(50, 72)], "clouds have short windows, which do not meet"
    (cause,) = bench.document("encounter-22222222")["causes"]
    assert (cause["event"], cause["stopped"]) == ("2" * 12, None)
    assert not [gap for audit in bench.database.audits("encounter-00000000") for gap in audit["gaps"]]


def test_counts_never_fall_when_a_recording_is_over(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    forget = Journal.remove_listener
    counted = list[int]()

    def counting(journal: Journal, listener: Listener) -> None:
        counted.append(bench.recordings.counts()["offered"])
        forget(journal, listener)

    monkeypatch.setattr(Journal, "remove_listener", counting)
    event = Event("0123456789ab", bench.now)
    bench.recordings.trigger(event, bench.now)
    bench.play(10)
    bench.recordings.end(event, bench.now)
    bench.play(30)
    until(lambda: bench.play(1) or counted)
    assert counted == [bench.recordings.counts()["offered"]]


def test_without_an_event_nothing_is_created(bench: Bench) -> None:
    bench.play(30)
    assert bench.recordings.stop(5.0)
    assert not bench.database.collections
    assert not bench.volume.files


def test_what_had_left_the_buffer_is_a_gap(bench: Bench) -> None:
    bench.buffers[A] = RingBuffer(BufferBounds(10, 10**6, count=5))
    bench.play(50)
    bench.recordings.trigger(Event("0123456789ab", BEGIN + 49 * 100 * MS), bench.now)
    assert bench.recordings.stop(5.0)
    (gap,) = add_up(bench.database.audits("encounter-01234567"))[A].gaps
    assert (gap.where, gap.count, gap.first, gap.last) == (
        "buffer", None, BEGIN + 29 * 100 * MS, BEGIN + 45 * 100 * MS - 1,
    )  # fmt: skip


def test_a_large_message_on_a_topic_of_documents_goes_to_a_segment(bench: Bench) -> None:
    bench.recordings.trigger(Event("0123456789ab", BEGIN), BEGIN)
    bench.recordings.offer(A, "p", Sample(BEGIN, BEGIN, bytes(200_000)))
    assert bench.recordings.stop(5.0)
    assert [entry["size"] for entry in bench.database.index("encounter-01234567")] == [200_000]


@given(st.lists(st.tuples(st.integers(0, 100), st.integers(0, 30)), min_size=1, max_size=8))
def test_windows_keep_what_some_event_asks_for(spans: list[tuple[int, int]]) -> None:
    windows = Windows((POSE,))
    for number, (start, _) in enumerate(spans):
        windows.begin(Event(str(number), start * SECOND))
    assert windows.running
    assert windows.last == FOREVER
    for number, (start, seconds) in enumerate(spans):
        windows.end(str(number), (start + seconds) * SECOND)
    asked = [(start - 2, start + seconds + 1) for start, seconds in spans]
    for second in range(-5, 140):
        wanted = any(first <= second <= last for first, last in asked)
        assert windows.contains(POSE, second * SECOND) == wanted
    intervals = windows.intervals(POSE)
    assert all(last + 1 < first for (_, last), (first, _) in pairwise(intervals))


@given(st.sets(st.integers(1, 198), max_size=HOLES_MAX), st.integers(1, 10**8))
def test_holes_of_a_regular_topic_are_counted_exactly(missing: set[int], period: int) -> None:
    stamps = [number * period for number in range(200) if number not in missing]
    gaps = holes(stamps)
    assert sum(count for *_, count in gaps) == len(missing)
    inside = {number for number in range(200) if any(first <= number * period <= last for first, last, _ in gaps)}
    assert inside == missing


@given(st.lists(st.integers(-(10**6), 10**6), min_size=200, max_size=200), st.integers(1, 190), st.integers(1, 8))
def test_a_hole_covers_what_is_missing_of_uneven_stamps(jitter: list[int], begin: int, count: int) -> None:
    stamps = [number * 10 * 10**6 + moved for number, moved in enumerate(jitter)]
    missing = stamps[begin : begin + count]
    [(first, last, missing_count)] = holes([stamp for stamp in stamps if stamp not in missing])
    assert (missing_count, sum(first <= stamp <= last for stamp in stamps)) == (count, count)
    assert all(first <= stamp <= last for stamp in missing)


def test_an_irregular_topic_has_no_holes() -> None:
    one_more = range(1, 2 * (HOLES_MAX + 1), 2)
    assert holes([number for number in range(200) if number not in one_more]) == [], "fewer than nine of ten are even"
    assert holes([number**2 * SECOND for number in range(100)]) == []


def test_recordings_are_told_while_they_are_open_and_after_they_have_ended() -> None:
    """What `GET /recordings` of a detector says."""
    bench = Bench()
    bench.play(30)
    event = Event("e" * 32, bench.now)
    bench.recordings.trigger(event, bench.now)
    bench.play(10)
    [opened] = bench.recordings.documents()
    assert (opened["recording"], opened["rule"], opened["volume"]) == ("encounter-eeeeeeee", "near", "n/c")
    assert (opened["ended"], opened["causes"][0]["event"], opened["causes"][0]["stopped"]) == (None, event.id, None)
    assert opened["provenance"] == bench.recordings.plan.provenance
    bench.recordings.end(replace(event, stamp=bench.now), bench.now)
    bench.play(int((1 + LINGER_SECONDS) * 10) + 2)

    def ended() -> bool:
        bench.recordings.tick(bench.now)
        return [document["ended"] for document in bench.recordings.documents()] == [bench.now]

    until(ended, "it has ended")
    [closed] = bench.recordings.documents()
    assert {audit["topic"]: audit["stored"] > 0 for audit in closed["topics"]} == {A: True, B: True, C: True}
    assert closed["causes"][0]["stopped"] is not None
    assert bench.recordings.stop(5)
