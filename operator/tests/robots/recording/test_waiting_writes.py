"""Writes that wait for the database: they are given up only when the volume refuses them, too."""

from __future__ import annotations

from collections.abc import Sequence

from robotkube.robots.recording.core.documents import SAMPLES, Write, messages_of
from robotkube.robots.recording.loops.destinations import RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.journal import Journal
from robotkube.testing.recordings import MemorySpool, RecordingDatabase, RecordingVolume

RECORDING, TOPIC = "task-1", "/pose"
BOUNDS = RecordingBounds(waiting_bytes=1_000)
FAR = 1_000.0


def sample(number: int) -> Write:
    """The write of one message of 100 bytes."""
    document = {"recording": RECORDING, "topic": TOPIC, "samples": [{"stamp": number, "data": b"", "sha256": ""}]}
    return Write(SAMPLES, f"{TOPIC}/{number}", document, size=100)


class SlowSpool(MemorySpool):
    """A spool that takes its time: more than may wait is added while the first file is written."""

    journal: Journal

    def put(self, writes: Sequence[Write]) -> str:
        first = not self.volume.batches
        name = super().put(writes)
        if first:
            self.journal.add(sample(number) for number in range(100, 150))
        return name


class SlowVolume(RecordingVolume):
    """A volume with such a spool."""

    journal: Journal

    def spool(self) -> MemorySpool:
        spool = SlowSpool(self)
        spool.journal = self.journal
        return spool


def journal_of(volume: RecordingVolume, database: RecordingDatabase) -> Journal:
    """A journal whose thread is the test's."""
    return Journal(RECORDING, RecorderPlace("v", lambda: database, lambda: volume, lambda: 0, lambda: 0.0), BOUNDS)


def stored(database: RecordingDatabase) -> list[int]:
    """Stamps of the stored messages."""
    buckets = database.buckets(RECORDING)
    return sorted(entry["stamp"] for bucket in buckets for entry in bucket["samples"])


def test_what_comes_while_the_spool_is_written_is_spooled_too() -> None:
    volume = SlowVolume()
    database = RecordingDatabase(away=True)
    journal = volume.journal = journal_of(volume, database)
    journal.add(sample(number) for number in range(50))
    journal.turn()
    assert len(volume.batches) == 1
    journal.turn()
    assert (journal.counts.dropped, journal.waiting, len(volume.batches)) == (0, 0, 2)
    database.away = False
    journal.finish(FAR)
    assert stored(database) == [*range(50), *range(100, 150)]


def test_what_the_volume_refuses_is_given_up_beyond_twice_the_bound() -> None:
    volume = RecordingVolume()
    database = RecordingDatabase(away=True)
    journal = journal_of(volume, database)
    journal.turn()
    volume.away = True
    journal.add(sample(number) for number in range(50))
    journal.turn()
    assert (journal.counts.dropped, journal.waiting) == (30, 20)
    volume.away = database.away = False
    journal.finish(FAR)
    assert stored(database) == [*range(30, 50)]
    assert [audit.dropped for audit in journal.audits(RECORDING)] == [30]
    assert not [write for writes, _ in volume.batches.values() for write in writes if messages_of(write)[1]]
