"""What somebody on the way tells about missing messages is in the audit once, also when the stamps show it, too."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.mqtt.core.message_properties import gap_text
from robotkube.robots.recording.core.audits import GAPS_MAX, SOURCE, TopicAudit, add_up
from robotkube.robots.recording.core.plans import RecordedTopic, RecordingPlan
from robotkube.robots.recording.loops.destinations import RecorderPlace
from robotkube.robots.recording.loops.recordings import Recordings
from robotkube.robots.ros.core.common_messages import string_message
from robotkube.robots.ros.core.gaps import Gap
from robotkube.robots.ros.core.ring_buffers import Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.testing.recordings import RecordingDatabase, RecordingVolume
from tests.stages.detector.in_memory import MS, NOW, DetectorStage, MemoryTasks
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.waiting import until

POSE = "/vehicles/vehicle_00/pose"
PERIOD, NUMBERS = 10_000_000, 200
BRIDGE = Gap(POSE, "mqtt-bridge of vehicle-00", "too many waited for the broker", 3, 50 * PERIOD, 52 * PERIOD)
PLAN = RecordingPlan("all", "r", "v", (RecordedTopic(TopicPattern("/vehicles/{agent}/pose"), "p", "document"),))
PLAIN = {key: value for key, value in SETTINGS.items() if key != "reactions"}


@pytest.fixture
def stage() -> Iterator[DetectorStage]:
    stage = DetectorStage(MemoryTasks())
    yield stage
    stage.close()


def written(audit: TopicAudit) -> list[Gap]:
    """The gaps of its document, with all holes."""
    document = {**audit.document([(0, 2**63 - 1)]), "closed": True}
    return list(add_up([document])[POSE].gaps)


@given(st.sets(st.integers(1, NUMBERS - 2), max_size=16), st.sets(st.integers(1, NUMBERS - 2)))
def test_what_is_told_and_what_the_stamps_show_is_counted_once(missing: set[int], known: set[int]) -> None:
    audit = TopicAudit(POSE)
    for number in range(NUMBERS):
        if number not in missing:
            audit.receive(number * PERIOD)
    for number in sorted(missing & known):
        audit.note_gap(replace(BRIDGE, count=1, first=number * PERIOD, last=number * PERIOD))
    gaps = written(audit)
    assert sum(gap.count or 0 for gap in gaps) == len(missing)
    assert all(any(gap.covers(number * PERIOD) for gap in gaps) for number in missing)
    assert sum(gap.count or 0 for gap in gaps if gap.where == SOURCE) == len(missing - known)
    assert (audit.dropped, audit.waiting) == (0, audit.received)


def test_gaps_are_bounded() -> None:
    audit = TopicAudit(POSE)
    for number in range(GAPS_MAX + 5):
        audit.note_gap(replace(BRIDGE, count=1, first=2 * number, last=2 * number))
    assert len(audit.never_received) == GAPS_MAX
    assert audit.never_received[-1] == replace(BRIDGE, count=6, first=2 * (GAPS_MAX - 1), last=2 * (GAPS_MAX + 4))


@pytest.fixture
def database() -> RecordingDatabase:
    return RecordingDatabase()


def recorded(database: RecordingDatabase, numbers: range, *told: Gap) -> None:
    """One recorder from its start to its end; it is told before its first message, as who comes later is."""
    volume = RecordingVolume()
    place = RecorderPlace("n/c", lambda: database, lambda: volume, time.time_ns, time.monotonic)
    recordings = Recordings(PLAN, place, {})
    recordings.start()
    until(lambda: recordings.ready)
    for gap in told:
        recordings.note_gap(gap)
    for number in numbers:
        recordings.offer(POSE, "p", Sample(number * PERIOD, number * PERIOD, b"pose %d" % number))
    assert recordings.stop(5.0)


def test_what_was_over_before_the_recording_is_none_of_its_gaps(database: RecordingDatabase) -> None:
    earlier = replace(BRIDGE, first=0, last=2 * PERIOD)
    recorded(database, range(40, 50), earlier, BRIDGE)
    (audit,) = database.audits("r")
    assert [gap.first for gap in add_up([audit])[POSE].gaps] == [BRIDGE.first]


def test_a_gap_alone_begins_no_recording(database: RecordingDatabase) -> None:
    recorded(database, range(0), BRIDGE)
    assert not database.recordings()


def test_a_second_writer_is_told_the_same_again(database: RecordingDatabase) -> None:
    recorded(database, range(40, 50), BRIDGE)
    recorded(database, range(53, 60), BRIDGE)
    assert len(database.audits("r")) == 2
    audit = add_up(database.audits("r"))[POSE]
    assert (audit.gaps, audit.unexplained(17)) == ((BRIDGE,), 0)


def test_what_bridges_gave_up_is_told_to_recordings(stage: DetectorStage) -> None:
    topic = {"name": "/vehicles/{agent}/pose", "storage": "document"}
    reaction = {"rule": "near", "kind": "recording", "recording": "r", "volume": "v", "topics": [topic]}
    stage.apply({**PLAIN, "reactions": [reaction]})
    gap = Gap(POSE, "mqtt-bridge of vehicle-00", "waited too long", 3, 10, 30)
    text = gap_text(gap).encode()
    stage.live.topics["/robotkube/gaps"].waiting = [(string_message(text), NOW), (string_message(b"[]"), NOW)]
    stage.pass_seconds(1.1)
    assert stage.recordings[0].gaps == [gap]
    stage.detector.change_state("inactive")
    assert stage.live.topics["/robotkube/gaps"].closed


def test_what_a_subscription_had_no_room_for_is_told_to_recordings(stage: DetectorStage) -> None:
    topic = {"name": "/vehicles/{agent}/pose", "storage": "document"}
    reaction = {"rule": "near", "kind": "recording", "recording": "r", "volume": "v", "topics": [topic]}
    stage.apply({**PLAIN, "reactions": [reaction]})
    stage.send("vehicle-00", 1.0)
    before = stage.now - 5 * MS
    stage.live.topics[POSE].lost += 7
    stage.pass_seconds(0.08)
    assert stage.recordings[0].gaps == [], "nobody knows yet until when"
    stage.send("vehicle-00", 1.0)
    stage.send("vehicle-00", 1.0)
    gap = Gap(POSE, "subscription", "pushed out before it was taken", 7, before + 1, before + 90 * MS - 1)
    assert stage.recordings[0].gaps == [gap], "once"
    assert stage.status.document()["topics"][POSE]["lost"] == 7
