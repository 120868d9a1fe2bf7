"""Poses: two a second of each agent, whatever comes, with where the agent looks."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.delivery.console.core.poses import PoseSampler
from robotkube.robots.mqtt.core.batches import encode_batch
from robotkube.robots.ros.core.common_messages import pose_and_heading, pose_position

TOPIC = "mqtt/vehicles/vehicle_00/pose"


def pose(x: float = 1.0, y: float = 2.0, yaw: float = 0.0, frame: bytes = b"map", scale: float = 1.0) -> bytes:
    """A serialised PoseStamped."""
    head = struct.pack("<iII", 1_795_250_010, 110_000_000, len(frame) + 1) + frame + b"\0"
    head += b"\0" * (-len(head) % 8)
    quaternion = (0.0, 0.0, scale * math.sin(yaw / 2), scale * math.cos(yaw / 2))
    return b"\x00\x01\x00\x00" + head + struct.pack("<7d", x, y, 0.0, *quaternion)


def sampler() -> PoseSampler:
    return PoseSampler("mqtt/vehicles/{agent}/pose", {"vehicle_00": "vehicle-00", "vehicle_01": "vehicle-01"})


@given(st.floats(-math.pi + 1e-6, math.pi), st.binary(max_size=9).filter(lambda b: b"\0" not in b), st.floats(0.1, 3))
def test_where_an_agent_looks(yaw: float, frame: bytes, scale: float) -> None:
    message = pose(yaw=yaw, frame=frame, scale=scale)
    x, y, z, heading = pose_and_heading(message)
    assert (x, y, z) == pose_position(message)
    assert heading == pytest.approx(yaw, abs=1e-6)


def test_an_orientation_that_is_none() -> None:
    assert pose_and_heading(pose(scale=0.0))[3] is None


@pytest.mark.parametrize("message", [b"", b"\x00\x01\x00\x00", pose()[:-1], pose(x=math.nan), pose(y=math.inf)])
def test_what_is_no_pose(message: bytes) -> None:
    with pytest.raises(ValueError, match=r"no PoseStamped|no header|not finite"):
        pose_and_heading(message)
    with pytest.raises(ValueError, match=r"no PoseStamped|no header|not finite"):
        sampler().sample(TOPIC, encode_batch(1, 0, [message]), 0)


@pytest.mark.parametrize("beat_ms", [10, 40, 70, 260, 499])
def test_however_often_poses_come_two_a_second_are_kept(beat_ms: int) -> None:
    kept = sampler()
    batch = encode_batch(1, 0, [pose()])
    now = 1_000_000
    times = [now + at for at in range(0, 60_000, beat_ms) if kept.sample(TOPIC, batch, now + at)]
    assert 115 <= len(times) <= 121


def test_agents_do_not_take_each_others_turn_and_the_last_of_a_batch_counts() -> None:
    kept = sampler()
    batch = encode_batch(1, 0, [pose(x=1), pose(x=5)])
    first, second = (kept.sample(f"mqtt/vehicles/vehicle_0{n}/pose", batch, 5000) for n in (0, 1))
    assert first is not None
    assert second is not None
    assert (first[0], second[0]) == ("vehicle-00", "vehicle-01")
    assert first[1] == {"x": 5, "y": 2, "z": 0, "heading": 0, "stamp_ms": 1_795_250_010_110, "received_ms": 5000}


@pytest.mark.parametrize(
    "topic", ["mqtt/vehicles/vehicle_02/pose", "mqtt/vehicles/vehicle_00/x/pose", "x", TOPIC + "s"]
)
def test_topics_of_nobody(topic: str) -> None:
    assert sampler().sample(topic, b"whatever", 0) is None


def test_the_topic_to_subscribe_to() -> None:
    assert sampler().topic == "mqtt/vehicles/+/pose"
