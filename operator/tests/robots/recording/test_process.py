"""The recorder's process: real ROS topics in, real database and files out; ended properly, and not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.foundation.database.adapters.connection import DatabaseLogin, connect
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.robots.recording.adapters.mongodb import PymongoRecordingReader
from robotkube.robots.recording.adapters.segments import McapSegmentReader
from robotkube.robots.recording.core.ledgers import LedgerLine
from robotkube.robots.recording.loops.reading import first_stamps, read_ledger, stored_messages, verify
from tests.stages.detector.process import PUBLISHER
from tests.stages.programs import free_port
from tests.stages.recording.seals import examined
from tests.stages.ros.ros_domains import domain as ros_domain
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

DATABASE, RECORDING = "recordings_cloud_0", "task-1"
SECONDS_MAX = 30.0
TYPES = {
    "pose": ("geometry_msgs/msg/PoseStamped", "document", "volatile", 1000),
    "cloud": ("sensor_msgs/msg/PointCloud2", "segment", "volatile", 50),
    "transform": ("geometry_msgs/msg/TransformStamped", "document", "transient_local", 1),
}
TOPICS = {f"/vehicles/vehicle_0{n}/{kind}": values for n in (0, 1) for kind, values in TYPES.items()}
SETTINGS: dict[str, Any] = {
    "name": "cloud-0/recorder",
    "topics": [
        {"name": name, "type": kind, "durability": durability, "depth": depth, "buffer": {"seconds": 1}}
        for name, (kind, _, durability, depth) in TOPICS.items()
    ],
    "rules": [{"name": "everything", "kind": "always"}],
    "reactions": [
        {
            "rule": "everything",
            "kind": "recording",
            "recording": RECORDING,
            "volume": "recordings",
            "provenance": {"task": "cloud-0/t"},
            "topics": [{"name": name, "storage": values[1]} for name, values in TOPICS.items()],
        }
    ],
}


class Site:
    """A folder with everything a pod would find mounted, and the processes on it."""

    def __init__(self, database_server: Any, folder: Path) -> None:
        self.folder = folder
        self.processes = list[subprocess.Popen[str]]()
        database_server.create_account("recorder", "secret", DATABASE)
        account = DatabaseLogin("127.0.0.1", database_server.port, DATABASE, "recorder", "secret", DATABASE)
        self.database = connect(account)
        self.reader = PymongoRecordingReader(self.database)
        self.segments = McapSegmentReader({"cloud-0/recordings": folder / "claim"})
        for name in ("claim", "ledgers", "secrets/database"):
            (folder / name).mkdir(parents=True)
        values = {**vars(account), "authenticationDatabase": account.authentication_database}
        for key in ("username", "password", "host", "port", "database", "authenticationDatabase"):
            (folder / "secrets/database" / key).write_text(str(values[key]))
        (folder / "config.yaml").write_text(write_mapping(SETTINGS))

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        variables = {
            **os.environ,
            "ROS_DOMAIN_ID": ros_domain(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.folder / "ros"),
            "PYTHONPATH": os.pathsep.join(sys.path),
            **environment,
        }
        process = subprocess.Popen(
            [sys.executable, *arguments], env=variables, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self.processes.append(process)
        return process

    def publish(self) -> subprocess.Popen[str]:
        publisher = self.start(*PUBLISHER, str(self.folder / "ledgers"), str(2 * SECONDS_MAX))
        assert publisher.stdout is not None
        assert "publishing\n" in publisher.stdout, publisher.communicate(timeout=SECONDS_MAX)[1]
        return publisher

    def record(self, port: int = 0) -> subprocess.Popen[str]:
        return self.start(
            "-m", "robotkube.robots.detector",
            NODE_NAME="cloud-0",
            ROBOTKUBE_CONFIG=str(self.folder / "config.yaml"),
            ROBOTKUBE_RECORDINGS=str(self.folder / "claim"),
            ROBOTKUBE_SECRETS=str(self.folder / "secrets"),
            ROBOTKUBE_HEALTH_PORT=str(port),
        )  # fmt: skip

    def until_stored(self, count: int) -> None:
        until(lambda: self.database["segments_index"].count_documents({}) >= count)

    def until_every_topic_is_stored(self) -> None:
        """Each has its own moment at which publisher and recorder find each other."""
        until(lambda: all(self.stored().values()), "every topic is stored", state=self.told)

    def stored(self) -> dict[str, int]:
        """Topic -> the number of its messages that are stored."""
        places = {name: "segments_index" if name.endswith("cloud") else "samples" for name in TOPICS}
        return {name: self.database[place].count_documents({"topic": name}) for name, place in places.items()}

    def told(self) -> str:
        """What is stored, and what the processes logged; they are ended for it."""
        ends = [process.poll() for process in self.processes]
        for process in self.processes:
            process.kill()
        logs = "\n".join(process.communicate(timeout=SECONDS_MAX)[1][-2000:] for process in self.processes)
        return f"{self.stored()}, exit codes {ends}\n{logs}"

    def received_up_to(self) -> int:
        """The last stamp that the recorder says it has of every stream."""
        audits = [audit for audit in self.reader.audits(RECORDING) if not audit["topic"].endswith("transform")]
        return min(int(audit["window"][1]) for audit in audits)

    def ledgers(self) -> dict[str, list[LedgerLine]]:
        ledgers = {}
        for name in TOPICS:
            path = self.folder / "ledgers" / f"{name.replace('/', '__')}.jsonl"
            with path.open() as file:
                ledgers[name] = read_ledger(file, str(path))
        return ledgers

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.communicate(timeout=SECONDS_MAX)
        self.database.client.close()


def log_of(process: subprocess.Popen[str]) -> list[dict[str, Any]]:
    _, text = process.communicate(timeout=SECONDS_MAX)
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


@pytest.fixture
def site(database_server: Any, tmp_path: Path) -> Iterator[Site]:
    site = Site(database_server, tmp_path)
    yield site
    site.close()


def test_sigterm_in_mid_write_leaves_a_complete_recording(site: Site) -> None:
    publisher = site.publish()
    recorder = site.record()
    site.until_stored(40)
    site.until_every_topic_is_stored()
    ended_at = time.time_ns()
    recorder.send_signal(signal.SIGTERM)
    assert recorder.wait(SECONDS_MAX) == 0
    publisher.terminate()
    publisher.wait(SECONDS_MAX)

    first = first_stamps(site.reader, RECORDING)
    window = (max(first.values()), site.received_up_to())
    ledgers = {name: lines for name, lines in site.ledgers().items() if not name.endswith("transform")}
    comparison = verify(site.reader, site.segments, RECORDING, ledgers, window)
    assert comparison.complete, comparison
    assert all(topic.stored > 10 for topic in comparison.topics.values())
    assert set(comparison.without_ledger) <= set(TOPICS)
    transforms = [m for m in stored_messages(site.reader, site.segments, RECORDING) if m.topic.endswith("transform")]
    assert {(m.topic, m.sha256) for m in transforms} == {
        (name, lines[0].sha256) for name, lines in site.ledgers().items() if name.endswith("transform")
    }
    (document,) = site.reader.recordings()
    assert document["ended"] > ended_at
    assert document["counts"]["dropped"] == 0
    events = [line["event"] for line in log_of(recorder)]
    assert any(event.startswith("recording task-1: first message of") for event in events)
    assert events[-1] == "ended"


def test_a_killed_recorder_leaves_everything_acknowledged_readable(site: Site) -> None:
    publisher = site.publish()
    first = site.record()
    site.until_stored(20)
    first.kill()
    first.wait(SECONDS_MAX)
    kept = {(m.topic, m.stamp, m.sha256) for m in stored_messages(site.reader, site.segments, RECORDING)}
    assert len(kept) > 100
    until(lambda: kept <= published(site), "every stored message is readable and equals what was published")

    before = site.database["segments_index"].count_documents({})
    second = site.record()
    site.until_stored(before + 20)
    second.send_signal(signal.SIGTERM)
    assert second.wait(SECONDS_MAX) == 0
    publisher.terminate()
    publisher.wait(SECONDS_MAX)
    everything = (0, time.time_ns())
    comparison = verify(site.reader, site.segments, RECORDING, site.ledgers(), everything)
    for topic in comparison.topics.values():
        assert (topic.duplicates, topic.mismatches, topic.unknown, topic.unreadable) == ((), (), (), ())
    assert kept <= {(m.topic, m.stamp, m.sha256) for m in stored_messages(site.reader, site.segments, RECORDING)}
    assert len(list((site.folder / "claim" / RECORDING).glob("*.mcap"))) == 2
    seals = examined(site.reader, site.segments, RECORDING)
    assert (seals.problems, seals.reservations) == ([], []), "the second has sealed what the first had not"


def published(site: Site) -> set[tuple[str, int, str]]:
    """What the publisher has written down by now, after it has published it."""
    return {(name, line.stamp, line.sha256) for name in TOPICS for line in partial(site, name)}


def partial(site: Site, name: str) -> list[LedgerLine]:
    text = (site.folder / "ledgers" / f"{name.replace('/', '__')}.jsonl").read_text()
    lines = [json.loads(line) for line in text.splitlines()[:-1]]
    return [LedgerLine(line["sequence"], line["stamp"], line["sha256"]) for line in lines] + last(text)


def last(text: str) -> list[LedgerLine]:
    """The last line may be half written."""
    try:
        line = json.loads(text.splitlines()[-1])
        return [LedgerLine(line["sequence"], line["stamp"], line["sha256"])]
    except (ValueError, KeyError):
        return []


def test_a_topic_of_a_type_that_the_image_does_not_have_is_refused_at_the_start(site: Site) -> None:
    """With file, key and what to do: recordings that lack a topic would look complete to whoever asked for it."""
    strange = {"name": "/vehicles/vehicle_00/strange", "type": "strange_msgs/msg/Strange"}
    (site.folder / "config.yaml").write_text(write_mapping({**SETTINGS, "topics": [*SETTINGS["topics"], strange]}))
    recorder = site.record()
    *_, line = log_of(recorder)
    assert recorder.returncode == 2
    words = f"{site.folder / 'config.yaml'}: topics[{len(TOPICS)}].type: type strange_msgs/msg/Strange: message package"
    assert line["error"].startswith(f"{words} strange_msgs is not installed in this image; take another type")


def test_without_a_node_name_the_process_says_what_to_set(site: Site) -> None:
    process = site.start(
        "-m", "robotkube.robots.detector",
        ROBOTKUBE_CONFIG=str(site.folder / "config.yaml"),
        ROBOTKUBE_HEALTH_PORT="0",
    )  # fmt: skip
    line = log_of(process)[-1]
    assert process.returncode == 2
    assert "NODE_NAME is not set" in line["error"]


def test_readiness_names_what_is_missing(site: Site, database_server: Any) -> None:
    database_server.kill()
    port = free_port()
    process = site.record(port)
    until(lambda: state(port)[0] == 503 and "database or volume claim has not answered yet: task-1" in state(port)[1])
    database_server.start()
    until(lambda: state(port)[0] == 200)
    process.send_signal(signal.SIGTERM)
    assert process.wait(SECONDS_MAX) == 0


def state(port: int) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=2) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()
    except OSError as error:
        return 0, str(error)
