"""Kill -9 in mid-write and a disk that is full: real processes, real database, real file systems."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingReader
from robotkube.robots.recording.adapters.segments import McapSegmentReader
from robotkube.robots.recording.core.ledgers import LedgerLine
from robotkube.robots.recording.core.verification import examine
from robotkube.robots.recording.loops.reading import audits, stored_messages, wrong_segments

pytestmark = pytest.mark.toolchain

RECORDING, VOLUME, DATABASE = "task-1", "cloud-0/recordings", "recordings_cloud_0"
SECONDS_MAX = 60.0
KILLS_THOROUGH = 25
ALWAYS = (0, 2**63 - 1)


class Site:
    """A database, a claim, and the ledgers of the processes that recorded there."""

    def __init__(self, database_server: Any, folder: Path) -> None:
        database_server.create_account("recorder", "secret", DATABASE)
        self.port = database_server.port
        self.claim = folder / "claim"
        self.claim.mkdir()
        self.ledgers: dict[str, list[LedgerLine]] = {"/pose": [], "/cloud": []}

    def record(self, seconds: float, kill_after: float | None = None) -> None:
        """One process; killed so long after its first message, or ended as it should."""
        command = [
            sys.executable,
            "-m",
            "tests.stages.recording.recording_writer",
            str(self.port),
            str(self.claim),
            str(seconds),
        ]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        timer: threading.Timer | None = None
        for line in process.stdout:
            if timer is None and kill_after is not None:
                timer = threading.Timer(kill_after, process.kill)
                timer.start()
            if line.endswith("\n"):
                topic, stamp, sha256 = line.split()
                self.ledgers[topic].append(LedgerLine(len(self.ledgers[topic]), int(stamp), sha256))
        status = process.wait(SECONDS_MAX)
        process.stdout.close()
        assert status == (0 if kill_after is None else -9)

    def check(self) -> int:
        """Everything stored is right, everything missing is explained; the number of stored messages."""
        database = connect(DatabaseLogin("127.0.0.1", self.port, DATABASE, "recorder", "secret", DATABASE))
        reader = PymongoRecordingReader(database)
        segments = McapSegmentReader({VOLUME: self.claim})
        stored = list(stored_messages(reader, segments, RECORDING))
        for topic in examine(stored, audits(reader, RECORDING), self.ledgers, ALWAYS):
            assert topic.comparison is not None
            assert (topic.duplicates, topic.mismatches, topic.unreadable) == (0, (), ())
            assert (topic.comparison.mismatches, topic.comparison.unknown) == ((), ())
            assert topic.unexplained == 0, topic
        assert not wrong_segments(reader, segments, RECORDING)
        assert len(reader.segments(RECORDING)) == len(list(self.claim.rglob("*.mcap")))
        (document,) = reader.recordings()
        assert document["ended"]
        database.client.close()
        return len(stored)

    def read_segments(self) -> int:
        """The number of messages that another reader finds."""
        count = 0
        for path in self.claim.rglob("*.mcap"):
            with path.open("rb") as file:
                reader = make_reader(file)
                summary = reader.get_summary()
                assert summary is not None
                assert summary.statistics is not None
                messages = sum(1 for _ in reader.iter_messages())
                assert messages == summary.statistics.message_count
                count += messages
        return count


def kill_and_check(database_server: Any, folder: Path, kills: int, seed: int) -> None:
    site = Site(database_server, folder)
    moments = random.Random(seed)  # noqa: S311 - not for secrets
    for _ in range(kills):
        site.record(SECONDS_MAX, kill_after=moments.uniform(0.4, 1.5))
    site.record(0.3)
    stored = site.check()
    assert stored > 20
    assert 0 < site.read_segments() <= len(site.ledgers["/cloud"])


def test_what_a_killed_recorder_acknowledged_is_there_and_the_rest_is_in_the_audit(
    database_server: Any, tmp_path: Path
) -> None:
    kill_and_check(database_server, tmp_path, 1, 5)


@pytest.mark.thorough
def test_many_killed_recorders_in_a_row(database_server: Any, tmp_path: Path) -> None:
    kill_and_check(database_server, tmp_path, KILLS_THOROUGH, 6)


def test_on_a_full_disk_the_oldest_of_the_spool_goes_and_is_named(tmp_path: Path) -> None:
    # a mount of its own name space: it is gone with the process
    mount = 'mount -t tmpfs -o size=4m none "$1" && exec "$2" -m "$3" "$1" 60'
    command = [
        "unshare",
        "--mount",
        "sh",
        "-c",
        mount,
        "sh",
        str(tmp_path),
        sys.executable,
        "tests.stages.recording.full_disk",
    ]
    began = time.monotonic()
    result = subprocess.run(command, capture_output=True, text=True, timeout=2 * SECONDS_MAX, check=False)
    assert result.returncode == 0, result.stderr
    assert time.monotonic() - began < SECONDS_MAX
    left = json.loads(result.stdout)
    gaps = [gap for audit in left["audits"] for gap in audit["gaps"]]
    lost = sorted(set(range(12_000)) - set(left["found"]))
    assert left["complete"]
    assert lost
    assert sum(gap["count"] for gap in gaps) == len(lost) == left["counts"]["dropped"]
    assert all(any(gap["first"] <= stamp <= gap["last"] for gap in gaps) for stamp in lost)
    assert lost[0] == 0, "the oldest went first"
    assert 11_999 in left["found"]
    assert all(gap["where"] == "spool" and gap["why"].startswith("disk full: ") for gap in gaps), gaps
    assert not list(tmp_path.rglob("*.bson")), "the mount is gone"
