"""A broker that is killed and stays away while two vehicles are recorded: the audit has what an independent count from
the players' ledgers has. What is there is then verified and exported with the commands that people use."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from robotkube.cli import main as cli
from robotkube.cli.recordings import commands as cli_recordings
from robotkube.cli.recordings.volumes import HOSTNAME
from robotkube.robots.recording.core.audits import SOURCE
from robotkube.robots.recording.loops.reading import audits, stored_messages
from robotkube.robots.recording.loops.recorder import BEGIN_SECONDS_MAX
from tests.stages.recording.database_server import DatabaseServer
from tests.stages.recording.two_vehicles import (
    AGENTS,
    BEFORE_SECONDS,
    CLOUD,
    CLOUD_HZ,
    ENCOUNTER,
    POSE,
    RECORDING,
    TRANSFORM,
    VOLUME,
    RecordedPath,
)

pytestmark = pytest.mark.toolchain

KILLED_AFTER = 2.0
STORE = get_typestore(Stores.ROS2_JAZZY)
CLOUDS = CLOUD.format(agent="vehicle_00")
POSES = [POSE.format(agent=agent.replace("-", "_")) for agent in AGENTS]
TRANSFORMS = TRANSFORM.format(agent="vehicle_00")
BRIDGE = "mqtt-bridge of vehicle-00"
PLACES = {BRIDGE, SOURCE}
"""Where clouds are lost: the vehicle's bridge has no room for all; on a busy machine some do not even come so far,
which the recorder concludes from the stamps that it received."""
IN_FLIGHT_MAX = 10
"""Poses of one frame or two: what the broker has acknowledged and not passed on dies with it."""


@pytest.fixture(
    scope="module",
    params=[(3.0, 12.0), pytest.param((20.0, 34.0), marks=pytest.mark.thorough)],
    ids=["3 s", "20 s"],
)
def way(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RecordedPath]:
    """What is left of a run in which the broker was away for so long, of so many seconds."""
    away, seconds = request.param
    folder = tmp_path_factory.mktemp("way")
    folder.chmod(0o755)
    server = DatabaseServer(folder / "database", "0.0.0.0")  # noqa: S104 - pods reach it at their node's gateway
    server.start()
    try:
        made = RecordedPath(folder, server, seconds, away)
        with made.api:
            try:
                made.run(KILLED_AFTER)
                yield made
            finally:
                made.close()
    finally:
        server.close()


def lost(way: RecordedPath, topic: str) -> list[int]:
    """Stamps that a player published and that are not in the recording, counted without any audit."""
    stored = {
        (message.topic, message.stamp, message.sha256)
        for message in stored_messages(way.reader, way.segments, RECORDING)
    }
    return [line.stamp for line in way.ledgers()[topic] if (topic, line.stamp, line.sha256) not in stored]


def test_the_audit_has_what_the_ledgers_say_is_missing(way: RecordedPath) -> None:
    audited = audits(way.reader, RECORDING)
    clouds = [m.stamp for m in stored_messages(way.reader, way.segments, RECORDING) if m.topic == CLOUDS]
    assert set(audited) == {*POSES, CLOUDS, TRANSFORMS}
    assert (lost(way, TRANSFORMS), audited[TRANSFORMS].gaps) == ([], ())
    for topic in POSES:
        gone = lost(way, topic)
        assert len(gone) <= IN_FLIGHT_MAX
        assert sum(gap.count or 0 for gap in audited[topic].gaps) == len(gone)
        assert all(any(gap.covers(stamp) for gap in audited[topic].gaps) for stamp in gone)
    missing = lost(way, CLOUDS)
    gaps = audited[CLOUDS].gaps
    early, missing = missing[: audited[CLOUDS].early], missing[audited[CLOUDS].early :]
    assert early == [line.stamp for line in way.ledgers()[CLOUDS]][: len(early)]
    assert len(early) <= BEGIN_SECONDS_MAX * CLOUD_HZ, "clouds that were there before the first pose of each vehicle"
    assert len(missing) > (way.away - 2.0) * CLOUD_HZ / 2
    assert [gap.count for gap in gaps] == [sum(gap.first <= stamp <= gap.last for stamp in missing) for gap in gaps], (
        gaps
    )
    assert sum(gap.count or 0 for gap in gaps) == len(missing)
    told_by_bridge = [gap for gap in gaps if gap.where == BRIDGE]
    assert told_by_bridge
    assert {stamp for gap in told_by_bridge for stamp in (gap.first, gap.last)} <= set(missing)
    assert {gap.where for gap in gaps} <= PLACES
    assert not any(gap.covers(stamp) for gap in gaps for stamp in clouds)


@dataclass(frozen=True)
class Here:
    """A cluster whose one volume is a folder of this machine."""

    claim: Path

    def volumes(self) -> list[dict[str, Any]]:
        """PersistentVolumes."""
        node, claim = VOLUME.split("/")
        here = [{"key": HOSTNAME, "operator": "In", "values": [node]}]
        affinity = {"required": {"nodeSelectorTerms": [{"matchExpressions": here}]}}
        return [{"spec": {"local": {"path": str(self.claim)}, "claimRef": {"name": claim}, "nodeAffinity": affinity}}]


def test_what_came_before_an_event_is_in_its_recording(way: RecordedPath) -> None:
    (document,) = [recording for recording in way.reader.recordings() if recording["_id"] != RECORDING]
    (cause,) = document["causes"]
    assert (document["_id"], cause["rule"]) == (f"{ENCOUNTER}-{cause['event'][:8]}", "near")
    assert cause["agents"] == list(AGENTS)
    stored = list(stored_messages(way.reader, way.segments, document["_id"]))
    first = cause["started"] - BEFORE_SECONDS * 1_000_000_000
    for topic in (*POSES, CLOUDS):
        missing = lost(way, topic)
        expected = [line for line in way.ledgers()[topic] if line.stamp >= first and line.stamp not in missing]
        assert len(expected) > CLOUD_HZ
        assert sorted((one.stamp, one.sha256) for one in stored if one.topic == topic) == sorted(
            (line.stamp, line.sha256) for line in expected
        )
    assert [one.topic for one in stored if one.topic == TRANSFORMS] == [TRANSFORMS]


def command(way: RecordedPath, monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """A command about the recording, with the accounts and volumes of this place in place of a cluster's."""
    monkeypatch.setattr(cli_recordings, "readers_of", lambda options: {"cloud-0": way.reader})
    monkeypatch.setattr(cli_recordings, "Platform", lambda options: Here(way.claim))
    return cli.main(["recording", words[0], RECORDING, *words[1:]])


def test_verify_proves_the_checksums_and_names_the_gaps(
    way: RecordedPath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    places = [f"--ledgers={folder}" for folder in way.ledger_folders()]
    assert command(way, monkeypatch, "verify", *places, "-o", "json") == cli.EXIT_REFUSED
    out, err = capsys.readouterr()
    rows = {row["topic"]: row for row in json.loads(out)["topics"]}
    for name in (*POSES, TRANSFORMS):
        assert (rows[name]["missing"], rows[name]["unexplained"]) == (len(lost(way, name)), 0)
    clouds = rows[CLOUDS]
    missing = len(lost(way, CLOUDS)) - audits(way.reader, RECORDING)[CLOUDS].early
    assert (clouds["missing"], clouds["lost"], clouds["unexplained"]) == (missing, missing, 0)
    assert {(row["mismatches"], row["duplicates"], row["unreadable"]) for row in rows.values()} == {(0, 0, 0)}
    assert f"{CLOUDS}: {len(clouds['gaps'])} gaps" in err
    assert BRIDGE in {gap["where"] for gap in clouds["gaps"]} <= PLACES


def test_everything_about_it_is_shown(
    way: RecordedPath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(way, monkeypatch, "show") == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    (gap, *_) = shown["audits"][CLOUDS]["gaps"]
    first = min(audits(way.reader, RECORDING)[CLOUDS].gaps, key=lambda one: one.first)
    assert (gap["where"], gap["first"]) == (first.where, first.first)
    files = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (way.claim / RECORDING).glob("*.mcap")]
    assert sorted(file["sha256"] for file in shown["files"]) == sorted(files)


def test_one_changed_byte_is_found(
    way: RecordedPath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = next(entry for entry in way.reader.index(RECORDING))
    path = next(way.claim.rglob(entry["segment"]))
    data = path.read_bytes()
    try:
        place = entry["offset"] + entry["size"] // 2
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        assert command(way, monkeypatch, "verify", "-o", "json") == cli.EXIT_REFUSED
        out, err = capsys.readouterr()
        (row,) = [row for row in json.loads(out)["topics"] if row["topic"] == CLOUDS]
        assert row["mismatches"] == 1
        assert f"{CLOUDS}: 1 with other bytes than were stored" in err
        assert f"{entry['segment']}: is not the file that was finished" in err
    finally:
        path.write_bytes(data)


def test_everything_is_exported_as_it_was_published(
    way: RecordedPath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    target = tmp_path / "out"
    assert command(way, monkeypatch, "export", str(target), f"--segments={VOLUME}={way.claim}", "--labels") == 0
    with Reader(target) as reader:
        messages = [(c.topic, c.msgtype, bytes(data)) for c, _, data in reader.messages()]
    for kind, data in {(kind, data) for _, kind, data in messages}:
        STORE.deserialize_cdr(data, kind)
    digests = sorted((topic, hashlib.sha256(data).hexdigest()) for topic, _, data in messages)
    missing = {(topic, stamp) for topic in (*POSES, CLOUDS) for stamp in lost(way, topic)}
    assert digests == sorted(
        (topic, line.sha256)
        for topic, lines in way.ledgers().items()
        for line in lines
        if (topic, line.stamp) not in missing
    )
    capsys.readouterr()
    lines = [json.loads(line) for line in (target / "dataset" / "labels.jsonl").read_text().splitlines()]
    assert len(lines) >= len(way.ledgers()[CLOUDS]) - len(missing) - 1, "nothing is extrapolated"
    assert all(label["agent"] == AGENTS[1] and label["points"] > 5 for line in lines for label in line["labels"])


def test_a_part_is_exported_as_one_mcap_file(
    way: RecordedPath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    first = way.ledgers()[POSES[0]][50].stamp
    last = first + 1_000_000_000
    words = ["--format=mcap", "--from", str(first), "--to", str(last), "--topics", POSES[1], CLOUD]
    target = tmp_path / "out"
    assert command(way, monkeypatch, "export", str(target), *words) == 0
    capsys.readouterr()
    with (target / f"{RECORDING}.mcap").open("rb") as file:
        messages = [(channel.topic, message.publish_time) for _, channel, message in make_reader(file).iter_messages()]
    assert sorted(messages) == sorted(
        (topic, line.stamp)
        for topic in (POSES[1], CLOUDS)
        for line in way.ledgers()[topic]
        if first <= line.stamp <= last
    )
    assert {path.name for path in target.iterdir()} == {f"{RECORDING}.mcap", f"{RECORDING}.layout.json"}
