"""The recorder on a real database and real files: once and completely, also when things go away in between."""

from __future__ import annotations

import hashlib
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.certificates.adapters.issuing import throw_away
from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingReader, PymongoRecordingStore
from robotkube.robots.recording.adapters.segments import McapSegmentReader
from robotkube.robots.recording.adapters.volume_claim import MountedVolumeClaim
from robotkube.robots.recording.core.ledgers import LedgerLine
from robotkube.robots.recording.core.plans import RecordedTopic, RecordingPlan
from robotkube.robots.recording.loops import journal
from robotkube.robots.recording.loops.counters import RecorderCounts
from robotkube.robots.recording.loops.destinations import BOUNDS, RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.reading import first_stored, list_recordings, stored_messages, verify
from robotkube.robots.recording.loops.recordings import Recordings
from robotkube.robots.recording.ports import RecordingStore
from robotkube.robots.ros.core.ring_buffers import Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from tests.stages.programs import free_port
from tests.stages.recording.database_server import NAME
from tests.stages.recording.seals import examined
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

DATABASE, VOLUME, RECORDING = "recordings_cloud_0", "cloud-0/recordings", "task-1"
POSE, CLOUD = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/PointCloud2"
POSES, CLOUDS = "/vehicles/vehicle_00/pose", "/vehicles/vehicle_00/cloud"
BEGIN = 1_795_250_000_000_000_000
MS = 1_000_000
STOP_SECONDS_MAX = 30.0  # with a database that answers; taken by a machine that is busy
PLAN = RecordingPlan(
    rule="everything",
    recording=RECORDING,
    volume="recordings",
    topics=(
        RecordedTopic(TopicPattern(POSES), POSE, "document", latched=True),
        RecordedTopic(TopicPattern(CLOUDS), CLOUD, "segment"),
    ),
    trace="ab",
    provenance={"task": "cloud-0/t"},
)
STREAMING = replace(PLAN, topics=tuple(replace(topic, latched=False) for topic in PLAN.topics))


class Bench:
    """A recorder with everything it needs, and the ledger of what it was offered."""

    def __init__(self, database_server: Any, root: Path) -> None:
        self.server, self.root = database_server, root
        self.ledgers: dict[str, list[LedgerLine]] = {POSES: [], CLOUDS: []}
        self.recorders: list[Recordings] = []
        self.account = DatabaseLogin("127.0.0.1", database_server.port, DATABASE, "recorder", "secret", DATABASE)
        database_server.create_account("recorder", "secret", DATABASE)
        self.database = connect(self.account)
        self.ahead = 0.0  # seconds by which the recorder's clock is set on
        self.answer_seconds_max = 0.5  # what it costs to find out that the database is away

    def open_store(self) -> RecordingStore:
        return PymongoRecordingStore(connect(self.account, self.answer_seconds_max))

    def recorder(self, plan: RecordingPlan = PLAN, bounds: RecordingBounds = BOUNDS) -> Recordings:
        self.root.mkdir(exist_ok=True)
        place = RecorderPlace(
            VOLUME, self.open_store, lambda: MountedVolumeClaim(self.root, RECORDING, time.time_ns), time.time_ns,
            lambda: time.monotonic() + self.ahead,
        )  # fmt: skip
        recorder = Recordings(plan, place, {}, bounds)
        self.recorders.append(recorder)
        recorder.start()
        return recorder

    def offer(self, recorder: Recordings, topic: str, number: int, again: bool = False) -> None:
        large = topic == CLOUDS
        data = number.to_bytes(4, "little") * (80_000 if large else 30)
        stamp = BEGIN + number * (100 if large else 10) * MS
        if not again:
            self.ledgers[topic].append(LedgerLine(number, stamp, hashlib.sha256(data).hexdigest()))
        recorder.offer(topic, CLOUD if large else POSE, Sample(stamp, time.time_ns(), data))

    def second(self, recorder: Recordings, second: int) -> None:
        """What arrives within one second."""
        for number in range(second * 100, second * 100 + 100):
            self.offer(recorder, POSES, number)
            if number % 10 == 0:
                self.offer(recorder, CLOUDS, number // 10)

    @property
    def reader(self) -> PymongoRecordingReader:
        return PymongoRecordingReader(self.database)

    @property
    def segments(self) -> McapSegmentReader:
        return McapSegmentReader({VOLUME: self.root})

    def assert_complete(self, seconds: int) -> None:
        comparison = verify(self.reader, self.segments, RECORDING, self.ledgers, (BEGIN, BEGIN + 10**12))
        assert comparison.complete, comparison
        assert comparison.topics[POSES].stored == 100 * seconds
        assert comparison.topics[CLOUDS].stored == 10 * seconds
        seals = examined(self.reader, self.segments, RECORDING)
        assert (seals.problems, seals.reservations) == ([], [])


def counts(recordings: Recordings) -> RecorderCounts:
    (recorder,) = recordings.recorders
    return recorder.counts


@pytest.fixture
def bench(database_server: Any, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(database_server, tmp_path / "claim")
    yield bench
    for recorder in bench.recorders:
        recorder.stop(2.0)
    bench.database.client.close()


def test_a_recording_is_complete_after_its_stop(bench: Bench) -> None:
    before = time.time_ns()
    recorder = bench.recorder()
    for second in range(3):
        bench.second(recorder, second)
    assert recorder.stop(STOP_SECONDS_MAX)
    bench.assert_complete(3)
    (document,) = list_recordings(bench.reader)
    assert document["_id"] == RECORDING
    assert document["volumes"] == [VOLUME]
    assert document["provenance"] == {"task": "cloud-0/t"}
    assert document["ended"] > document["started"] > before
    assert document["counts"]["dropped"] == 0
    stored = list(bench.reader.index(RECORDING))
    assert all(before < entry["stored"] < time.time_ns() for entry in stored)
    assert first_stored(bench.reader, RECORDING) == {CLOUDS: min(entry["stored"] for entry in stored)}


def test_the_first_large_message_is_stored_at_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """It waits for no batch: the next one would be due in an hour, and so would another try to reach the database."""
    bench.answer_seconds_max = STOP_SECONDS_MAX
    monkeypatch.setattr("robotkube.robots.recording.loops.recorder.ROUND_SECONDS", 3600.0)
    monkeypatch.setattr("robotkube.robots.recording.loops.journal.ROUND_SECONDS", 3600.0)
    recorder = bench.recorder()
    until(lambda: recorder.ready)
    bench.offer(recorder, CLOUDS, 0)
    until(lambda: CLOUDS in counts(recorder).first_stored)


def test_messages_that_come_twice_are_stored_once(bench: Bench) -> None:
    recorder = bench.recorder()
    for _ in range(2):
        for number in range(20):
            bench.offer(recorder, POSES, number, again=number in {line.sequence for line in bench.ledgers[POSES]})
            bench.offer(recorder, CLOUDS, number, again=number in {line.sequence for line in bench.ledgers[CLOUDS]})
        until(lambda: recorder.counts()["documents"] == 20)
    assert recorder.stop(STOP_SECONDS_MAX)
    assert recorder.counts()["duplicates"] == 40
    comparison = verify(bench.reader, bench.segments, RECORDING, bench.ledgers, (BEGIN, BEGIN + 10**12))
    assert comparison.complete, comparison


def test_a_second_recorder_goes_on_without_storing_anything_again(bench: Bench) -> None:
    first = bench.recorder()
    bench.second(first, 0)
    assert first.stop(STOP_SECONDS_MAX)
    second = bench.recorder()
    until(lambda: second.ready)
    for number in range(50, 100):
        bench.offer(second, POSES, number, again=True)
    bench.second(second, 1)
    assert second.stop(STOP_SECONDS_MAX)
    bench.assert_complete(2)
    (document,) = list_recordings(bench.reader)
    assert document["volumes"] == [VOLUME]
    assert document["ended"]


def test_a_recorder_that_goes_on_with_other_topics_names_them_beside_the_earlier_ones(bench: Bench) -> None:
    first = bench.recorder()
    bench.offer(first, POSES, 0)
    assert first.stop(STOP_SECONDS_MAX)
    every = RecordedTopic(TopicPattern("/vehicles/{agent}/pose"), POSE, "document")
    second = bench.recorder(replace(PLAN, topics=(every,)))
    until(lambda: second.ready)
    second.offer("/vehicles/vehicle_01/pose", POSE, Sample(BEGIN, BEGIN, b"data"))
    assert second.stop(STOP_SECONDS_MAX)
    (document,) = list_recordings(bench.reader)
    assert document["topics"] == {
        POSES: {"type": POSE, "storage": "document", "latched": True},
        CLOUDS: {"type": CLOUD, "storage": "segment"},
        "/vehicles/{agent}/pose": {"type": POSE, "storage": "document"},
    }


def test_different_messages_of_one_stamp_are_both_kept(bench: Bench) -> None:
    recorder = bench.recorder()
    for data in (b"one" * 100, b"two" * 100):
        recorder.offer(CLOUDS, CLOUD, Sample(BEGIN, BEGIN, data))
        recorder.offer(POSES, POSE, Sample(BEGIN, BEGIN, data))
    assert recorder.stop(STOP_SECONDS_MAX)
    messages = [(m.topic, m.sha256) for m in stored_messages(bench.reader, bench.segments, RECORDING)]
    assert len(set(messages)) == len(messages) == 4


def test_reception_goes_on_while_the_database_is_away(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "SPOOL_SECONDS", 600.0)  # the outage counts as a short one, however slow the machine
    recorder = bench.recorder()
    bench.second(recorder, 0)  # known to the database, all of it: the first word of a topic would go to the spool
    until(lambda: recorder.counts()["acknowledged"] == 110 and recorder.waiting == 0)
    before = recorder.counts()  # a database that is slow to answer counts as away, too
    bench.server.kill()
    for second in range(1, 4):  # comes back from every one of them, although nobody will take what is written
        bench.second(recorder, second)
    until(lambda: recorder.counts()["retries"] > before["retries"] and recorder.counts()["segments"] == 40)
    assert (recorder.counts()["offered"], recorder.counts()["dropped"]) == (440, 0)
    assert recorder.waiting > 0
    bench.server.start()
    until(lambda: recorder.waiting == 0)
    assert recorder.stop(STOP_SECONDS_MAX)
    bench.assert_complete(4)
    assert recorder.counts()["spooled"] == before["spooled"]


def test_a_recorder_goes_where_its_account_leads_when_the_database_speaks_tls(bench: Bench) -> None:
    """As when a platform changes over, and the kubelet has brought the changed Secret."""
    recorder = bench.recorder()
    bench.second(recorder, 0)
    until(lambda: recorder.counts()["acknowledged"] == 110 and recorder.waiting == 0)
    bench.server.kill()
    bench.second(recorder, 1)
    until(lambda: recorder.counts()["retries"] > 0, "a try that failed")
    bench.server.port = free_port()
    bench.server.issued = throw_away(NAME)
    bench.server.start()
    bench.account = replace(bench.account, port=bench.server.port, tls=bench.server.tls)
    until(lambda: recorder.waiting == 0)
    assert recorder.stop(STOP_SECONDS_MAX)
    bench.database.client.close()
    bench.database = connect(bench.account)
    bench.assert_complete(2)


def test_a_database_that_comes_late_gets_everything(bench: Bench) -> None:
    bench.server.kill()
    recorder = bench.recorder()
    bench.second(recorder, 0)
    until(lambda: recorder.counts()["retries"] > 0, "a try that failed")
    assert not recorder.ready
    bench.server.start()
    until(lambda: recorder.ready)
    assert recorder.stop(STOP_SECONDS_MAX)
    bench.assert_complete(1)


@pytest.mark.parametrize("database_at_start", [True, False])
def test_the_spool_carries_a_recording_over_a_missing_database(bench: Bench, database_at_start: bool) -> None:
    if not database_at_start:
        bench.server.kill()
    first = bench.recorder()
    if database_at_start:
        until(lambda: first.ready)
        bench.server.kill()
    bench.second(first, 0)
    (recording,) = first.recorders
    recording.end()
    until(lambda: recording.stopped)  # the journal has everything, however long that took
    assert not (first.stop(1.5) and first.counts()["spooled"] == 0)  # written or spooled, else it is not complete
    until(lambda: first.counts()["spooled"] > 0 and first.waiting == 0)
    bench.server.start()
    second = bench.recorder()
    until(lambda: second.ready and second.waiting == 0)
    assert not list((bench.root / "spool").iterdir())
    assert second.stop(STOP_SECONDS_MAX)
    bench.assert_complete(1)
    assert all(entry["stored"] for entry in bench.reader.index(RECORDING))


def test_a_file_of_the_spool_that_cannot_be_read_holds_up_nothing(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    (bench.root / "spool").mkdir(parents=True)
    unreadable = bench.root / "spool" / "0.bson"
    unreadable.symlink_to("/proc/self/mem")  # its first page is never mapped: reading it is an I/O error
    recorder = bench.recorder()
    until(lambda: recorder.ready)
    bench.second(recorder, 0)
    assert recorder.stop(STOP_SECONDS_MAX)
    bench.assert_complete(1)
    assert [path.name for path in (bench.root / "spool").iterdir()] == ["0.bson"]
    assert "the spooled 0.bson stays where it is" in caplog.text


def test_waiting_writes_are_bounded_by_the_spool(bench: Bench) -> None:
    recorder = bench.recorder(bounds=RecordingBounds(waiting_bytes=50_000))
    until(lambda: recorder.ready)
    bench.server.kill()
    for second in range(6):
        bench.second(recorder, second)
    until(lambda: recorder.counts()["spooled"] > 0)
    bench.server.start()
    recorder.stop(STOP_SECONDS_MAX)
    successor = bench.recorder()
    until(lambda: successor.ready)
    assert successor.stop(STOP_SECONDS_MAX)
    bench.assert_complete(6)


def test_a_claim_that_refuses_loses_nothing_once_it_takes_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    full = threading.Event()
    refused = 0
    synchronise = os.fdatasync

    def refuse(descriptor: int) -> None:
        nonlocal refused
        if full.is_set():
            refused += 1
            raise OSError(28, "No space left on device")
        synchronise(descriptor)

    monkeypatch.setattr("os.fdatasync", refuse)
    recorder = bench.recorder()
    bench.second(recorder, 0)
    until(lambda: recorder.counts()["segments"] == 10)
    full.set()
    bench.second(recorder, 1)
    until(lambda: refused >= 3)
    until(lambda: recorder.counts()["documents"] == 200)  # documents do not wait for the volume
    assert recorder.counts()["segments"] == 10
    full.clear()
    assert recorder.stop(STOP_SECONDS_MAX)
    bench.assert_complete(2)


def test_a_recording_begins_when_its_streams_flow(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "robotkube.robots.recording.loops.recorder.BEGIN_SECONDS_MAX", 600.0
    )  # no stream counts as silent
    recorder = bench.recorder(STREAMING)
    for number in range(3):
        bench.offer(recorder, CLOUDS, number)  # stamps 0, 100, 200 ms: nobody knows yet which poses will be missing
    for number in range(25, 100):
        bench.offer(recorder, POSES, number)  # the first one is of 250 ms
    bench.offer(recorder, CLOUDS, 1, again=True)
    for number in range(3, 10):
        bench.offer(recorder, CLOUDS, number)
    assert recorder.stop(STOP_SECONDS_MAX)
    assert recorder.counts()["early"] == 4
    stored = [m.stamp for m in stored_messages(bench.reader, bench.segments, RECORDING) if m.topic == CLOUDS]
    assert stored == [BEGIN + number * 100 * MS for number in range(3, 10)]


def test_a_silent_stream_does_not_hold_the_recording_up_for_ever(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robotkube.robots.recording.loops.recorder.BEGIN_SECONDS_MAX", 600.0)
    recorder = bench.recorder(STREAMING)
    bench.offer(recorder, CLOUDS, 0)
    bench.ahead = 600.0
    bench.offer(recorder, CLOUDS, 1)
    assert recorder.stop(STOP_SECONDS_MAX)
    assert (recorder.counts()["early"], recorder.counts()["segments"]) == (1, 1)


def test_an_error_of_ours_is_told_and_never_called_complete(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise KeyError("a mistake")

    monkeypatch.setattr("robotkube.robots.recording.loops.recorder.bucket_documents", fail)
    recorder = bench.recorder()
    bench.offer(recorder, POSES, 0)
    until(lambda: recorder.failed != "")
    bench.offer(recorder, POSES, 1)
    assert "a mistake" in recorder.failed
    assert not recorder.stop(2.0)
