"""What plugins read from the buffers: the latest, at a time, in a range, of several agents; and who still sends."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from robotkube.robots.detector.core.liveness import EXPIRED, FRESH, STALE, FreshnessBounds, changes, freshness
from robotkube.robots.ros.core.cdr import CdrWriter, Header
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.geometry import Quaternion, slerp
from robotkube.robots.ros.core.ring_buffers import BufferBounds, BufferPool, Sample
from robotkube.robots.rules.core.windows import Window

MS = 1_000_000
PATTERN, BATTERY, TRANSFORM = "/vehicles/{agent}/pose", "/vehicles/vehicle_00/battery", "/transform"
POSE = "/vehicles/vehicle_00/pose"
DEFINITIONS = {
    "test_msgs/msg/Pose": "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    "test_msgs/msg/Transform": "Vector3 translation\ngeometry_msgs/Quaternion rotation\n===\n"
    "MSG: test_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
    "test_msgs/msg/Battery": "uint16 cell\nfloat32 share\nbool charging\nstring name\nfloat32[] cells\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/msg/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
TYPES = {PATTERN: "test_msgs/msg/Pose", BATTERY: "test_msgs/msg/Battery", TRANSFORM: "test_msgs/msg/Transform"}
POSITION = ["pose.position.x", "pose.position.y"]


class Stage:
    """Buffers that are filled by hand, and the window on them."""

    def __init__(self) -> None:
        self.pool = BufferPool(10**6)
        self.window = Window(self.pool.buffers, TYPES, Layouts(DEFINITIONS.__getitem__))

    def insert(self, topic: str, ms: int, data: bytes) -> None:
        if topic not in self.pool.buffers:
            self.pool.make(topic, BufferBounds(100, 10**6))
        self.pool.buffers[topic].insert(Sample(ms * MS, ms * MS + 5, data))

    def pose(self, ms: int, x: float, y: float = 0.0, turn: float = 0.0, agent: str = "vehicle_00") -> None:
        writer = CdrWriter()
        writer.header(Header(ms * MS, "map"))
        for value in (x, y, 0.0, *about_z(turn)):
            writer.number("d", value)
        self.insert(f"/vehicles/{agent}/pose", ms, bytes(writer.data))

    def battery(self, ms: int, cell: int, share: float, charging: bool, name: str, cells: Sequence[float]) -> None:
        writer = CdrWriter()
        for code, value in (("H", cell), ("f", share), ("?", charging)):
            writer.number(code, value)
        writer.text(name)
        for code, value in (("I", len(cells)), *(("f", one) for one in cells)):
            writer.number(code, value)
        self.insert(BATTERY, ms, bytes(writer.data))


def about_z(degrees: float) -> Quaternion:
    half = math.radians(degrees) / 2
    return 0.0, 0.0, math.sin(half), math.cos(half)


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_the_latest_and_the_one_before(stage: Stage) -> None:
    assert stage.window.latest(POSE, POSITION) is None
    for ms, x in ((100, 1.0), (200, 2.0), (150, 1.5)):
        stage.pose(ms, x)
    latest = stage.window.latest(POSE, POSITION)
    before = stage.window.before(POSE, 199 * MS, POSITION)
    assert latest
    assert (latest.stamp, latest.values) == (200 * MS, (2.0, 0.0))
    assert before
    assert (before.stamp, before.values) == (150 * MS, (1.5, 0.0))
    assert stage.window.before(POSE, 99 * MS, POSITION) is None


def test_the_latest_of_every_agent(stage: Stage) -> None:
    stage.pose(100, 1.0)
    stage.pose(300, 3.0, agent="vehicle_01")
    readings = stage.window.latest_per_agent(PATTERN, POSITION[:1])
    assert {agent: reading.values for agent, reading in readings.items()} == {
        "vehicle-00": (1.0,),
        "vehicle-01": (3.0,),
    }
    assert stage.window.topics(PATTERN)["vehicle-01"] == "/vehicles/vehicle_01/pose"
    assert stage.window.topics(POSE) == {"": POSE}


def test_numbers_between_two_messages_are_linear(stage: Stage) -> None:
    stage.pose(100, 1.0, 10.0)
    stage.pose(200, 2.0, 20.0)
    for ms, expected in ((100, (1.0, 10.0)), (125, (1.25, 12.5)), (200, (2.0, 20.0))):
        reading = stage.window.at(POSE, ms * MS, POSITION)
        assert reading
        assert reading.stamp == ms * MS
        assert reading.values == pytest.approx(expected)


def test_nothing_is_extrapolated_or_bridged(stage: Stage) -> None:
    for ms in (100, 200, 1300):
        stage.pose(ms, 1.0)
    assert [stage.window.at(POSE, ms * MS, POSITION) for ms in (99, 1301, 250)] == [None] * 3
    assert stage.window.at(POSE, 250 * MS, POSITION, gap_seconds=1.2) is not None
    assert stage.window.at("/vehicles/vehicle_07/pose", 250 * MS, POSITION) is None


def test_what_is_no_number_comes_from_the_message_before(stage: Stage) -> None:
    stage.battery(100, 2, 0.5, True, "full", [1.0])
    stage.battery(200, 4, 0.25, False, "less", [2.0, 3.0])
    reading = stage.window.at(BATTERY, 150 * MS, ["share", "charging", "name", "cells", "cell"])
    assert reading
    assert (*reading.values[:3], list(reading.values[3]), reading.values[4]) == (0.375, True, "full", [1.0], 3.0)


def test_poses_turn_the_shorter_way(stage: Stage) -> None:
    stage.pose(100, 1.0, turn=170)
    stage.pose(200, 3.0, turn=-170)
    pose = stage.window.pose_at(POSE, 150 * MS)
    assert pose
    assert pose.position == pytest.approx((2.0, 0.0, 0.0))
    assert [abs(value) for value in pose.orientation] == pytest.approx([abs(value) for value in about_z(180)])
    with pytest.raises(ValueError, match=f"{POSE} has no pose at 'header'"):
        stage.window.pose_at(POSE, 150 * MS, "header")


def test_transforms_are_poses_and_no_orientation_is_none(stage: Stage) -> None:
    writer = CdrWriter()
    for value in (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0):
        writer.number("d", value)
    stage.insert(TRANSFORM, 100, bytes(writer.data))
    pose = stage.window.pose_at(TRANSFORM, 100 * MS, "")
    assert pose
    assert (pose.position, pose.orientation) == ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))


quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1)


@given(quaternions, quaternions, st.floats(0, 1))
def test_slerp_turns_evenly(one: Quaternion, other: Quaternion, share: float) -> None:
    """The angle to both ends is in proportion, the length stays 1, and a sign of either end changes no rotation."""
    a, b = (tuple(value / math.hypot(*q) for value in q) for q in (one, other))
    assume(abs(np.dot(a, b)) > 1e-6)
    turned = slerp(a, b, share)
    whole = angle(a, b)
    assert math.hypot(*turned) == pytest.approx(1)
    assert angle(a, turned) == pytest.approx(whole * share, abs=2e-3)
    assert angle(turned, b) == pytest.approx(whole * (1 - share), abs=2e-3)
    assert angle(turned, slerp(tuple(-value for value in a), b, share)) == pytest.approx(0, abs=1e-3)


def angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Radians between two rotations."""
    return 2 * math.acos(min(1.0, abs(float(np.dot(a, b)))))


def test_ranges_are_columns_that_numpy_reads_in_place(stage: Stage) -> None:
    for ms, share in ((100, 0.5), (200, 0.25), (300, 0.125)):
        stage.battery(ms, ms, share, ms == 200, "n", [share])
    stage.insert(BATTERY, 250, b"no battery")
    columns = stage.window.range(BATTERY, 150 * MS, 300 * MS, ["share", "cell", "charging", "name", "cells"])
    assert len(columns) == 2
    assert np.frombuffer(columns.stamps, np.int64).tolist() == [200 * MS, 300 * MS]
    assert np.frombuffer(columns.received, np.int64).tolist() == [200 * MS + 5, 300 * MS + 5]
    assert np.frombuffer(columns["share"], columns["share"].typecode).tolist() == [0.25, 0.125]
    assert np.frombuffer(columns["cell"], np.uint16).tolist() == [200, 300]
    assert np.frombuffer(columns["charging"], np.bool_).tolist() == [True, False]
    assert (columns["name"], [list(cells) for cells in columns["cells"]]) == (["n", "n"], [[0.25], [0.125]])
    assert len(stage.window.range("/vehicles/vehicle_09/pose", 0, 1, POSITION)) == 0


def test_agents_are_joined_at_one_time(stage: Stage) -> None:
    for ms in (100, 200):
        stage.pose(ms, ms / 100)
        stage.pose(ms + 30, ms / 10, agent="vehicle_01")
    stage.pose(500, 1.0, agent="vehicle_02")
    readings = stage.window.join(["vehicle-00", "vehicle-01", "vehicle-02"], PATTERN, 160 * MS, POSITION[:1])
    assert {agent: reading.values[0] for agent, reading in readings.items()} == pytest.approx(
        {"vehicle-00": 1.6, "vehicle-01": 13.0}
    )


def test_messages_that_cannot_be_read_are_passed_over(stage: Stage) -> None:
    stage.pose(100, 1.0)
    stage.insert(POSE, 110, b"\0\1\0\0cut off")
    stage.pose(200, 2.0)
    stage.insert(POSE, 210, b"")
    latest = stage.window.latest(POSE, POSITION)
    between = stage.window.at(POSE, 150 * MS, POSITION)
    assert latest
    assert latest.stamp == 200 * MS
    assert between
    assert between.values[0] == pytest.approx(1.5)


def test_wrong_topics_and_fields_are_named(stage: Stage) -> None:
    with pytest.raises(ValueError, match="/other fits no topic pattern"):
        stage.window.latest("/other", POSITION)
    with pytest.raises(ValueError, match="test_msgs/Pose has no field speed"):
        stage.window.at(POSE, 0, ["speed"])


def test_agents_go_stale_and_expire() -> None:
    bounds = FreshnessBounds(1.0, 5.0)
    last = {"a": 9_000 * MS, "b": 8_999 * MS, "c": 4_999 * MS}
    states = freshness(last, 10_000 * MS, bounds)
    assert states == {"a": FRESH, "b": STALE, "c": EXPIRED}
    assert changes({"a": FRESH, "b": FRESH, "c": EXPIRED}, states) == {"b": STALE}
    assert changes({}, states) == {"b": STALE, "c": EXPIRED}
    assert changes({"a": STALE}, {"a": FRESH}) == {"a": FRESH}
    with pytest.raises(ValueError, match="swap them"):
        FreshnessBounds(2.0, 1.0)
