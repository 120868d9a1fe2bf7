"""What storing costs: ten seconds of two vehicles until the segment is synchronised and the database has acknowledged.

Beside it, in the same run and folder, the same bytes written and synchronised by a plain loop: the disk's own time.
"""

from __future__ import annotations

import hashlib
import os
import socket
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measuring.pods import Pod
from ci.machine import preparing
from robotkube.foundation.certificates.adapters.issuing import throw_away
from robotkube.foundation.certificates.adapters.verification import ServerVerification
from robotkube.foundation.certificates.core.lives import Issued
from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.registry.suites.core.namespace_contents import database_files
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingReader, PymongoRecordingStore
from robotkube.robots.recording.adapters.segments import McapSegmentReader
from robotkube.robots.recording.adapters.volume_claim import MountedVolumeClaim
from robotkube.robots.recording.core.plans import RecordedTopic, RecordingPlan
from robotkube.robots.recording.loops.destinations import RecorderPlace
from robotkube.robots.recording.loops.reading import stored_messages
from robotkube.robots.recording.loops.recordings import Recordings
from robotkube.robots.ros.core.ring_buffers import Sample
from robotkube.robots.ros.core.topic_patterns import TopicPattern

VEHICLES = ("vehicle_00", "vehicle_01")
SECONDS = 10
POSES_PER_SECOND, CLOUDS_PER_SECOND = 100, 10
POSE_BYTES, CLOUD_BYTES = 100, 320_000
POSE_TYPE, CLOUD_TYPE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/PointCloud2"
VOLUME, DATABASE = "cloud-0/recordings", "recordings_cloud_0"
USER, PASSWORD, NAME = "administrator", "of this benchmark", "database"
REPETITIONS = 5
SECONDS_MAX = 60.0
POLL_SECONDS = 0.001
BEGIN = 1_795_250_000_000_000_000
"""Stamps begin here, ns."""


@dataclass(frozen=True)
class Stored:
    """Medians in seconds; `lost` is the number of messages that were offered and are not found afterwards."""

    seconds: float
    baseline_seconds: float
    lost: int

    @property
    def seconds_max(self) -> float:
        """What it may take: 0.25 s, or 1.3 times the disk's own time."""
        return max(0.25, 1.3 * self.baseline_seconds)


Message = tuple[str, str, Sample]


def store_ten_seconds(repetitions: int = REPETITIONS) -> Stored:
    """Measure, in turns with the baseline, each time with a recording of its own. The first of each only warms up."""
    with tempfile.TemporaryDirectory() as text, _database(Path(text) / "database") as database:
        folder = Path(text)
        messages = list(ten_seconds())
        ours = []
        theirs = []
        lost = 0
        for number in range(repetitions + 1):
            theirs.append(_plain(folder / "plain", [sample.data for *_, sample in messages]))
            volume = folder / f"volume-{number}"
            volume.mkdir()
            site = _Site(database, volume, f"bench-{number}")
            ours.append(site.store(messages))
            lost += site.lost(messages)
        return Stored(statistics.median(ours[1:]), statistics.median(theirs[1:]), lost)


def cpu_seconds(encrypted: bool) -> dict[str, float]:
    """Processor time of recorder and database for the same ten seconds. RuntimeError when messages were lost."""
    issued = throw_away(NAME) if encrypted else None
    with tempfile.TemporaryDirectory() as text, _database(Path(text) / "database", issued) as database:
        messages = list(ten_seconds())
        volume = Path(text) / "volume"
        volume.mkdir()
        site = _Site(database, volume, "bench")
        began = {"recorder": time.process_time(), "database": database.pod.cpu_seconds()}
        site.store(messages)
        ended = {"recorder": time.process_time(), "database": database.pod.cpu_seconds()}
        if site.lost(messages):
            raise RuntimeError(f"{site.lost(messages)} messages are not found")
    return {part: ended[part] - began[part] for part in began}


def ten_seconds() -> Iterator[Message]:
    """2,000 poses and 200 clouds of 320 kB, in the order of their stamps."""
    for number in range(SECONDS * POSES_PER_SECOND):
        stamp = BEGIN + number * 10**9 // POSES_PER_SECOND
        for vehicle in VEHICLES:
            yield f"/vehicles/{vehicle}/pose", POSE_TYPE, Sample(stamp, stamp, os.urandom(POSE_BYTES))
        for vehicle in VEHICLES if number % (POSES_PER_SECOND // CLOUDS_PER_SECOND) == 0 else ():
            yield f"/vehicles/{vehicle}/cloud", CLOUD_TYPE, Sample(stamp, stamp, os.urandom(CLOUD_BYTES))


@dataclass(frozen=True)
class _Database:
    """A FerretDB process, and how it proves who it is."""

    port: int
    pod: Pod
    tls: ServerVerification | None


class _Site:
    """A database account, the folder of a volume claim, and the recording that goes there."""

    def __init__(self, database: _Database, volume: Path, name: str) -> None:
        self._account = DatabaseLogin("127.0.0.1", database.port, DATABASE, USER, PASSWORD, "admin", database.tls)
        self._volume = volume
        self._name = name
        topics = [
            RecordedTopic(TopicPattern(f"/vehicles/{vehicle}/{kind}"), type_name, storage)
            for vehicle in VEHICLES
            for kind, type_name, storage in (("pose", POSE_TYPE, "document"), ("cloud", CLOUD_TYPE, "segment"))
        ]
        self._plan = RecordingPlan("everything", name, "recordings", tuple(topics))
        self._place = RecorderPlace(
            VOLUME,
            lambda: PymongoRecordingStore(connect(self._account)),
            lambda: MountedVolumeClaim(volume, name, time.time_ns),
            time.time_ns,
            time.monotonic,
        )

    def store(self, messages: Sequence[Message]) -> float:
        """Seconds from the first offer until segment and database have everything."""
        recordings = Recordings(self._plan, self._place, {})
        recordings.start()
        _until(lambda: recordings.ready)
        (recorder,) = recordings.recorders
        began = time.perf_counter()
        for topic, type_name, sample in messages:
            recordings.offer(topic, type_name, sample)
        _until(lambda: recorder.counts.acknowledged == len(messages))
        seconds = time.perf_counter() - began
        if not recordings.stop(SECONDS_MAX):
            raise RuntimeError(f"the recording did not end: {recordings.failed or recordings.counts()}")
        return seconds

    def lost(self, messages: Sequence[Message]) -> int:
        """How many of the messages are not found, or not as they were."""
        database = connect(self._account)
        stored = {
            (message.topic, message.stamp, message.sha256)
            for message in stored_messages(
                PymongoRecordingReader(database), McapSegmentReader({VOLUME: self._volume}), self._name
            )
        }
        database.client.close()
        wanted = {(topic, s.stamp, hashlib.sha256(s.data).hexdigest()) for topic, _, s in messages}
        return len(wanted - stored)


def _plain(path: Path, contents: Sequence[bytes]) -> float:
    """Seconds to write and synchronise the same bytes without anything else."""
    began = time.perf_counter()
    with path.open("wb") as file:
        for data in contents:
            file.write(data)
        file.flush()
        os.fsync(file.fileno())
    seconds = time.perf_counter() - began
    path.unlink()
    return seconds


def _until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + SECONDS_MAX
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {SECONDS_MAX:.0f} s")
        time.sleep(POLL_SECONDS)


@contextmanager
def _database(folder: Path, issued: Issued | None = None) -> Iterator[_Database]:
    """A FerretDB process with the account of the set-up; with a certificate it speaks TLS alone."""
    (folder / "data").mkdir(parents=True)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    listeners = [f"--listen-addr=127.0.0.1:{port}"]
    if issued is not None:
        for name, text in database_files(issued).items():
            (folder / name).write_text(text)
        listeners = ["--listen-addr=", f"--listen-tls=127.0.0.1:{port}"]
        listeners += [f"--listen-tls-cert-file={folder}/tls.crt", f"--listen-tls-key-file={folder}/tls.key"]
    command = [
        str(preparing.tool_chain() / "ferretdb"), "--handler=sqlite", f"--sqlite-url=file:{folder}/data/",
        f"--state-dir={folder}", *listeners, "--debug-addr=-", "--telemetry=disable", "--setup-database=admin",
        "--log-level=ERROR",
    ]  # fmt: skip
    environment = {**os.environ, "FERRETDB_SETUP_USERNAME": USER, "FERRETDB_SETUP_PASSWORD": PASSWORD}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _until(lambda: _listens(port))
        yield _Database(port, Pod("database", process), ServerVerification(folder / "ca.crt", NAME) if issued else None)
    finally:
        process.terminate()
        process.wait(SECONDS_MAX)


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return False
    return True


def main() -> None:
    """Print what was measured."""
    stored = store_ten_seconds()
    print(f"stored in {stored.seconds:.3f} s (at most {stored.seconds_max:.3f} s), ", end="")
    print(f"plain file {stored.baseline_seconds:.3f} s, lost {stored.lost}")


if __name__ == "__main__":
    main()
