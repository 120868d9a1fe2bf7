"""`robotkube recording export` on a recording in memory, read by an independent reader; selections and refusals."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from robotkube.cli import main as cli
from robotkube.cli.recordings.export import MCAP, ExportRequest, exported
from robotkube.errors import InputError, UnavailableError
from robotkube.robots.bags.adapters.command_line_bags import Bags
from robotkube.robots.export.core.labels import LabellingSettings
from robotkube.robots.export.loops.bag_export import Selection, first_stamp
from robotkube.robots.recording.core.documents import SEGMENT, Received, SegmentPlace, bucket_documents
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from scenarios import definition
from scenarios.generator import bags
from tests.stages.paths import SCENARIOS

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"
SETTINGS = ["vehicles=2", "encounters=1", "points=1000", "point_cloud_hz=2", "pose_hz=10"]
BEGIN = 1_795_250_000_000_000_000
DELAY_NS = 3_000_000
NAME, VOLUME = "lidar-proximity-3e07ce", "cloud-0/recordings"
STORE = get_typestore(Stores.ROS2_JAZZY)
POSES, CLOUDS = "/vehicles/{agent}/pose", "/vehicles/{agent}/lidar_center/pointcloud"
TRANSFORMS = "/vehicles/{agent}/lidar_center/transform"

Message = tuple[str, int, bytes]


class Memory:
    """A database with one recording of these messages, and its segments."""

    def __init__(self, messages: Sequence[Message]) -> None:
        kinds = {POSES: ("geometry_msgs/msg/PoseStamped", "document"), CLOUDS: ("sensor_msgs/msg/PointCloud2", SEGMENT)}
        topics: dict[str, Any] = {text: {"type": kind, "storage": how} for text, (kind, how) in kinds.items()}
        transform = {"type": "geometry_msgs/msg/TransformStamped", "storage": "document", "latched": True}
        self.document = {"_id": NAME, "started": BEGIN, "topics": {**topics, TRANSFORMS: transform}}
        small = [m for m in messages if TopicPattern(CLOUDS).agent(m[0]) is None]
        received = [Received(t, s, s + DELAY_NS, hashlib.sha256(d).hexdigest(), d) for t, s, d in small]
        self.samples = bucket_documents(NAME, received)
        self.clouds = [message for message in messages if message not in small]
        self.away = False
        self.gaps: list[dict[str, Any]] = []

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        return [self.document]

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        return reversed(self.samples)

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        for number, (topic, stamp, data) in enumerate(self.clouds):
            digest = hashlib.sha256(data).hexdigest()
            yield {"topic": topic, "stamp": stamp, "received": stamp + DELAY_NS, "sha256": digest, "size": len(data),
                   "volume": VOLUME, "segment": "one.mcap", "offset": number}  # fmt: skip

    def segments(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return []

    def audits(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return self.gaps

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        if self.away:
            raise UnavailableError(f"{volume}: is away")
        return self.clouds[place.offset][2]

    def manifests(self, recording: str) -> Sequence[Mapping[str, Any]]:
        return []

    def digest(self, volume: str, segment: str) -> tuple[str, int]:
        return "", 0

    def notes(self, volume: str, recording: str) -> Mapping[str, Sequence[str]]:
        return {}


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Message]:
    scenario = definition.load(FOLDER, SETTINGS)
    made = bags.make_bags(scenario, tmp_path_factory.mktemp("cache"), lambda text: None)
    with Bags(list(made.values()), pytest.fail) as opened:
        return list(opened.played(set(opened.types), BEGIN))


def read_rosbag(folder: Path) -> list[Message]:
    """By the library rosbags, which also decodes every message."""
    with Reader(folder) as reader:
        for connection in reader.connections:
            assert connection.msgdef.data
        written = [(c.topic, moment, data) for c, moment, data in reader.messages()]
        for connection, _, data in reader.messages():
            STORE.deserialize_cdr(data, connection.msgtype)
    return written


def test_a_rosbag2_folder_with_everything(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    table = exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    assert not table.refusal
    written = read_rosbag(tmp_path / "out")
    assert [moment for _, moment, _ in written] == sorted(moment for _, moment, _ in written)
    assert sorted(written) == sorted((topic, stamp + DELAY_NS, data) for topic, stamp, data in messages)
    assert sum(row["messages"] for row in table.rows) == len(messages)
    with Reader(tmp_path / "out") as reader:
        durabilities = {
            c.topic.rpartition("/")[2]: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections
        }
    assert durabilities == {"pose": "VOLATILE", "pointcloud": "VOLATILE", "transform": "TRANSIENT_LOCAL"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_one_mcap_file_of_a_selection(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    first, last = BEGIN + 2 * 10**9, BEGIN + 4 * 10**9
    selection = Selection((TopicPattern("/vehicles/vehicle_00/pose"), TopicPattern(TRANSFORMS)), first, last)
    exported(memory, memory, memory.document, tmp_path / "out", ExportRequest(selection, MCAP))
    with (tmp_path / "out" / f"{NAME}.mcap").open("rb") as file:
        written = [(c.topic, m.publish_time, s.encoding) for s, c, m in make_reader(file).iter_messages()]
    poses = [stamp for topic, stamp, _ in written if topic == "/vehicles/vehicle_00/pose"]
    assert poses == [t for n, t, _ in messages if n == "/vehicles/vehicle_00/pose" and first <= t <= last]
    assert {topic for topic, _, _ in written} == {
        "/vehicles/vehicle_00/pose",
        "/vehicles/vehicle_00/lidar_center/transform",
        "/vehicles/vehicle_01/lidar_center/transform",
    }
    assert {encoding for *_, encoding in written} == {"ros2msg"}
    layout = json.loads((tmp_path / "out" / f"{NAME}.layout.json").read_text())
    assert set(layout["configById"]["3D!space"]["topics"]) == {topic for topic, _, _ in written}
    assert not (tmp_path / "out" / "metadata.yaml").exists()


def test_a_dataset_beside_the_bag(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    exported(memory, memory, memory.document, tmp_path / "out", ExportRequest(), LabellingSettings())
    names = {path.name for path in (tmp_path / "out" / "dataset").iterdir()}
    assert names == {"training", "labels.jsonl", "README.md", "preview.png"}
    assert read_rosbag(tmp_path / "out")


def test_what_cannot_be_read_is_counted_and_refused(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    memory.away = True
    table = exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    assert f"{len(memory.clouds)} messages are not in the export; the first: " in table.refusal
    assert "is away" in table.refusal
    assert {row["topic"].rpartition("/")[2]: bool(row["left_out"]) for row in table.rows} == {
        "pose": False, "pointcloud": True, "transform": False,
    }  # fmt: skip
    memory.away = False
    memory.samples[0]["samples"][0]["data"] = b"changed"
    table = exported(memory, memory, memory.document, tmp_path / "other", ExportRequest())
    assert "1 messages are not in the export" in table.refusal
    assert "not those that were recorded" in table.refusal


def test_refusals_leave_nothing_behind(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="is there already"):
        exported(memory, memory, memory.document, tmp_path / "there", ExportRequest())
    nothing = ExportRequest(Selection((TopicPattern("/nothing"),)))
    with pytest.raises(InputError, match=r"there is nothing of /nothing; it holds .* /vehicles/vehicle_00/pose from"):
        exported(memory, memory, memory.document, tmp_path / "out", nothing)
    later = ExportRequest(Selection((TopicPattern(POSES),), first=2 * BEGIN))
    with pytest.raises(InputError, match=rf"no message is chosen by --from and --to; it holds .*pose from {BEGIN}"):
        exported(memory, memory, memory.document, tmp_path / "out", later)
    mistyped = ExportRequest(Selection((TopicPattern(POSES), TopicPattern("/vehicles/{agent}/poses"))))
    with pytest.raises(InputError, match=r"there is nothing of /vehicles/\{agent\}/poses; it holds"):
        exported(memory, memory, memory.document, tmp_path / "out", mistyped)
    poses = ExportRequest(Selection((TopicPattern(POSES),)))
    with pytest.raises(InputError, match="labels need clouds and the poses of at least two"):
        exported(memory, memory, memory.document, tmp_path / "out", poses, LabellingSettings())
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_an_export_touches_no_other_folder(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    (tmp_path / "out.partial").mkdir()
    (tmp_path / "out.partial" / "own").write_text("work")
    exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    assert (tmp_path / "out.partial" / "own").read_text() == "work"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out.partial"]


def test_a_message_that_is_stored_twice_is_exported_once(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    memory.samples.append({**memory.samples[0], "samples": [dict(one) for one in memory.samples[0]["samples"]]})
    for one in memory.samples[-1]["samples"]:
        one["received"] += 1
    exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    assert sorted(read_rosbag(tmp_path / "out")) == sorted((t, stamp + DELAY_NS, data) for t, stamp, data in messages)


def test_a_type_that_is_not_installed_is_exported_with_the_definition_that_came_with_it(tmp_path: Path) -> None:
    memory = Memory([("/vehicles/vehicle_00/pose", BEGIN, b"\0\1\0\0" + bytes(8))])
    memory.document["topics"] = {POSES: {"type": "own_msgs/msg/Height", "storage": "document"}}
    memory.document["definitions"] = {"own_msgs/msg/Height": "float64 height\n"}
    exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    with AnyReader([tmp_path / "out"]) as reader:
        ((connection, _, data),) = reader.messages()
        assert reader.deserialize(data, connection.msgtype).height == 0.0


def test_stamps_before_1970_are_counted_and_refused(messages: Sequence[Message], tmp_path: Path) -> None:
    memory = Memory(messages)
    memory.samples[0]["samples"][0]["stamp"] = -1
    table = exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    assert "1 messages are not in the export; the first: " in table.refusal
    assert "at -1: a bag has no times before 1970" in table.refusal


def given(*words: str) -> argparse.Namespace:
    whole = ["recording", "export", NAME, "out", *words]
    return cli.grammar_of(whole).parse_args(whole)


def test_times_are_given_in_three_ways() -> None:
    wanted = ExportRequest.of(given("--from", "1.5", "--to", str(BEGIN + 7), "--format", "mcap"), BEGIN - 2 * 10**9)
    assert (wanted.selection.first, wanted.selection.last) == (BEGIN - 500_000_000, BEGIN + 7)
    wanted = ExportRequest.of(given("--from", "2026-11-21T08:53:20.250Z"), BEGIN)
    assert wanted.selection.first == 1_795_251_200_250_000_000
    for words, message in (
        (("--from", "soon"), "--from 'soon' must be ns"),
        (("--from", "9", "--to", "3"), "--to 3 is before --from 9"),
        (("--topics", "pose"), "pose is not a full ROS topic name"),
    ):
        with pytest.raises(InputError, match=message):
            ExportRequest.of(given(*words), BEGIN)


def test_seconds_count_from_the_first_stamp_also_before_the_event(messages: Sequence[Message]) -> None:
    """What was taken from the buffer, and bags of another day, have stamps before the recorder's start."""
    memory = Memory(messages)
    memory.gaps = [
        {"topic": "/vehicles/vehicle_00/pose", "window": [BEGIN - 5, BEGIN + 9]},
        {"topic": "/vehicles/vehicle_01/pose", "window": [BEGIN - 7, BEGIN + 9]},
        {"topic": "/vehicles/vehicle_01/lidar_center/pointcloud", "window": None},
        {"topic": "/vehicles/vehicle_00/lidar_center/transform", "window": [1, 1]},
    ]
    assert first_stamp(memory, memory.document) == BEGIN - 7
    memory.gaps = []
    assert first_stamp(memory, memory.document) == BEGIN


def test_an_export_names_the_topics_of_which_there_is_no_message(
    messages: Sequence[Message], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    memory = Memory([message for message in messages if message[0].endswith("/pose")])
    table = exported(memory, memory, memory.document, tmp_path / "out", ExportRequest())
    silent = [(row["topic"], row["messages"]) for row in table.rows if row["type"] is None]
    assert silent == [(CLOUDS, 0), (TRANSFORMS, 0)]
    assert table.refusal == ""
    assert f"robotkube: {CLOUDS}: the recording lists it and has no message of it\n" in capsys.readouterr().err
    chosen = ExportRequest(Selection((TopicPattern(POSES),)))
    table = exported(memory, memory, memory.document, tmp_path / "chosen", chosen)
    assert all(row["messages"] for row in table.rows), "what was not asked for is not missed"


def test_an_export_of_a_recording_with_gaps_names_them(
    messages: Sequence[Message], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    memory = Memory(messages)
    pose, cloud = "/vehicles/vehicle_00/pose", "/vehicles/vehicle_01/lidar_center/pointcloud"
    full = {"where": "queue", "why": "storing is too slow", "count": 3, "first": BEGIN + 10, "last": BEGIN + 30}
    killed = {"where": "recorder", "why": "killed", "count": None, "first": BEGIN + 50, "last": BEGIN + 60}
    numbers = {"received": 9, "stored": 6, "early": 0, "duplicates": 0, "dropped": 3, "closed": True}
    memory.gaps = [
        {"topic": pose, "window": [BEGIN, BEGIN + 90], "gaps": [killed, full], **numbers},
        {"topic": cloud, "window": [BEGIN, BEGIN + 90], "gaps": [full], **numbers},
    ]
    selection = Selection((TopicPattern(pose),), BEGIN, BEGIN + 10**9)
    table = exported(memory, memory, memory.document, tmp_path / "out", ExportRequest(selection))
    (row,) = table.rows
    assert (row["missing"], row["gap_count"], row["gaps"]) == (3, 2, [full, killed])
    assert capsys.readouterr().err == (
        f"robotkube: {pose}: 2 gaps, at least 3 messages missing; the first: queue: storing is too slow, stamps "
        f"{BEGIN + 10} to {BEGIN + 30}; all in gaps.jsonl\n"
    )
    lines = [json.loads(line) for line in (tmp_path / "out" / "gaps.jsonl").read_text().splitlines()]
    assert lines == [{"topic": pose, **full}, {"topic": pose, **killed}]
    assert read_rosbag(tmp_path / "out"), "the folder is a bag all the same"
    later = ExportRequest(Selection((TopicPattern(pose),), BEGIN + 10**9))
    table = exported(memory, memory, memory.document, tmp_path / "later", later)
    assert table.rows[0]["gap_count"] == 0
    assert not (tmp_path / "later" / "gaps.jsonl").exists()
