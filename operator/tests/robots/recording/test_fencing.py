"""A recorder whose node was cut off: nothing is written to the database before its settings were read anew; when its
release was taken over meanwhile, what waits is discarded and counted, and is in nobody's way later."""

from __future__ import annotations

from typing import Any

import pytest

from robotkube.foundation.runtime.loops.fencing import BOUND_SECONDS_MAX, GAP_SECONDS_MAX, Fencing
from robotkube.robots.recording.core.documents import AUDITS, RECORDINGS, SAMPLES
from robotkube.robots.recording.loops.destinations import BOUNDS, RecorderPlace
from robotkube.robots.recording.loops.journal import SPOOL_SECONDS, Journal
from robotkube.robots.recording.loops.recorder import Recorder
from robotkube.testing.recordings import RecordingDatabase, RecordingVolume
from tests.stages.runtime.settings_reading import Reading

RECORDING, VOLUME, TOPIC = "task-1", "edge-0/recordings", "/pose"
SECOND_NS = 1_000_000_000
MOVABLE = {"movable": "true"}
ELSEWHERE = {"node": "edge-1", **MOVABLE}


class Stage:
    """Processes on one node that record in one thread; clock, database, volume and settings are the test's."""

    def __init__(self, movable: bool = True) -> None:
        self.now, self.sent = 100.0, 0
        self.database = RecordingDatabase()
        self.volume = RecordingVolume()
        self.begin(movable)
        self.read(MOVABLE if movable else {})

    def begin(self, movable: bool = True) -> None:
        """A new process, which has read nothing yet."""
        self.volume.forget_writers()
        self.reading = Reading()
        self.fencing = Fencing("edge-0", movable, lambda: self.now)
        self.fencing.watch(self.reading)
        clock = lambda: int(self.now * SECOND_NS)  # noqa: E731
        place = RecorderPlace(VOLUME, lambda: self.database, lambda: self.volume, clock, lambda: self.now, self.fencing)
        self.journal = Journal(RECORDING, place, bounds=BOUNDS)
        self.recorder = Recorder(RECORDING, {"rule": "r"}, self.journal, place)

    def read(self, settings: Any) -> None:
        """The API server answers."""
        self.fencing.observe(settings)
        self.reading.read_at = self.now
        self.reading.interrupted_at = None

    def record(self, seconds: float = 1.0) -> None:
        """A message, and what the threads do with it; then so much time."""
        self.sent += 1
        stamp = self.sent * SECOND_NS
        self.recorder.offer(TOPIC, "t", "document", stamp, stamp, b"%d" % self.sent)
        for _ in range(2):
            self.journal.turn()
            self.recorder.turn()
        self.journal.turn()
        self.now += seconds

    def cut(self) -> None:
        """Nothing reaches the node, and then everything does; its settings were not read yet."""
        self.database.away = True
        self.reading.interrupted_at = self.now
        for seconds in (GAP_SECONDS_MAX, GAP_SECONDS_MAX, BOUND_SECONDS_MAX - 0.2):
            self.record(seconds)
        self.database.away = False

    def end(self) -> bool:
        """What a process does that is asked to end."""
        self.recorder.end()
        self.recorder.finish()
        self.journal.finish(self.now + 100.0)
        return self.journal.complete

    @property
    def stored(self) -> list[bytes]:
        """Messages in the database."""
        return sorted(sample["data"] for bucket in self.database.buckets(RECORDING) for sample in bucket["samples"])


@pytest.mark.parametrize("movable", [True, False])
def test_nothing_is_written_before_the_settings_were_read_and_nothing_is_lost_when_they_are_its_own(
    movable: bool,
) -> None:
    stage = Stage(movable)
    stage.record()
    assert stage.stored == [b"1"]
    stage.cut()
    before = stage.reading.asked
    stage.reading.asked = 0
    stage.record(0.1)
    assert before > 0
    assert stage.stored == [b"1"]
    stage.read(MOVABLE if movable else {})
    stage.record(10.0)
    stage.record()
    assert stage.stored == [b"%d" % n for n in range(1, 8)]
    assert stage.end()
    assert not stage.volume.batches


@pytest.mark.parametrize("settings", [None, ELSEWHERE])
def test_what_was_taken_over_is_discarded_and_counted(settings: Any) -> None:
    stage = Stage()
    stage.record()
    stage.cut()
    assert stage.volume.batches, "what waits for long is safe from a kill"
    stage.record(0.1)
    documents = {name: dict(collection) for name, collection in stage.database.collections.items()}
    stage.read(settings)
    assert stage.fencing.lost
    stage.record()
    assert not stage.end()
    assert stage.stored == [b"1"]
    assert {name: dict(collection) for name, collection in stage.database.collections.items()} == documents
    assert not stage.volume.batches
    assert stage.journal.counts.discarded > 3
    (audit,) = stage.database.collections[AUDITS].values()
    assert not audit["closed"], "that it was interrupted is told by who takes the recording up"
    assert stage.database.collections[RECORDINGS][RECORDING]["ended"] is None


def test_what_was_spooled_while_it_was_known_to_be_its_own_is_kept_for_the_next_process() -> None:
    stage = Stage()
    stage.record()
    stage.database.away = True
    for _ in range(8):  # only the database is away: the settings are read again and again
        stage.record(SPOOL_SECONDS)
        stage.read(MOVABLE)
    known = set(stage.volume.batches)
    assert len(known) > 1
    stage.cut()
    everything = set(stage.volume.batches)
    stage.read(ELSEWHERE)
    assert not stage.end()
    assert known <= set(stage.volume.batches) < everything
    stage.begin()
    stage.read(MOVABLE)
    stage.record()
    stage.record()
    assert b"2" in stage.stored


def test_a_process_that_is_started_anew_writes_nothing_before_it_has_read() -> None:
    stage = Stage()
    stage.begin()
    stage.record()
    stage.record()
    assert not stage.journal.ready
    assert not stage.database.collections
    stage.read(None)
    assert not stage.end()
    assert not stage.database.collections
    assert SAMPLES not in stage.database.collections
