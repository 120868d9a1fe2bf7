"""Processes that record one after another, in one thread, into a database and a volume in memory."""

from __future__ import annotations

from typing import Any

from robotkube.cli.output import Table
from robotkube.cli.recordings import commands as cli_recordings
from robotkube.robots.recording.core.documents import MANIFESTS
from robotkube.robots.recording.loops.destinations import BOUNDS, RecorderPlace
from robotkube.robots.recording.loops.journal import Journal
from robotkube.robots.recording.loops.recorder import Recorder
from robotkube.testing.recordings import RecordingDatabase, RecordingVolume

RECORDING, VOLUME = "task-1", "cloud-0/recordings"
POSE, CLOUD = "/pose", "/cloud"
BEGIN, MS = 1_795_250_000_000_000_000, 1_000_000
TOPICS = {POSE: {"type": "p", "storage": "document"}, CLOUD: {"type": "c", "storage": "segment"}}


class Place:
    """A database and a volume, and processes that record there one after another."""

    def __init__(self) -> None:
        self.database = RecordingDatabase()
        self.volume = RecordingVolume()
        self.now = 0
        self.number = 0
        self.task = "t"
        self.clock_ahead_ns = 10**12

    def clock_ns(self) -> int:
        self.now += 1
        return BEGIN + self.clock_ahead_ns + self.now

    def process(self) -> tuple[Recorder, Journal]:
        self.volume.forget_writers()
        place = RecorderPlace(
            VOLUME, lambda: self.database, lambda: self.volume, self.clock_ns, lambda: self.now / 1000
        )
        journal = Journal(RECORDING, place, BOUNDS)
        document = {"rule": "r", "provenance": {"task": self.task}, "topics": TOPICS}
        recorder = Recorder(RECORDING, document, journal, place)
        journal.turn()
        return recorder, journal

    def offer(self, recorder: Recorder, journal: Journal, steps: int = 30) -> None:
        for _ in range(steps):
            for topic, size in ((POSE, 30), (CLOUD, 900)):
                data = self.number.to_bytes(4, "little") * size
                stamp = BEGIN + self.number * 100 * MS
                recorder.offer(topic, "t", TOPICS[topic]["storage"], stamp, stamp + 5, data)
            self.number += 1
            self.now += 500
            recorder.turn()
            journal.turn()

    def end(self, recorder: Recorder, journal: Journal) -> None:
        recorder.finish()
        journal.finish((self.now + 100_000) / 1000)

    def verified(self, keys: tuple[str, ...] = ()) -> Table:
        readers = {"cloud-0": self.database}
        return cli_recordings.verified(readers, self.volume, RECORDING, [], None, keys)

    @property
    def manifest(self) -> dict[str, Any]:
        """The document of the only writer's manifest."""
        (manifest,) = (one for one in self.collection(MANIFESTS).values() if "number" not in one)
        return manifest

    def collection(self, name: str) -> dict[str, dict[str, Any]]:
        return self.database.collections[name]


def killed_and_resumed() -> Place:
    """A writer that was killed, and one that went on behind it."""
    place = Place()
    process = place.process()
    place.offer(*process)
    process = place.process()
    place.offer(*process, steps=5)
    place.end(*process)
    return place
