"""The order of sending on real connections: what is less urgent stays in the bridge while the network does not take
what is more urgent, whatever the network would take of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from benchmarks.measuring.bags import message
from tests.stages.bridge.gates import Gates
from tests.stages.bridge.two_bridges import Stage, running

pytestmark = pytest.mark.processes

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
CLOUD = {"name": "/vehicles/vehicle_00/cloud", "type": "sensor_msgs/msg/PointCloud2", "channel": "bulk"}
BRAKE = {**POSE, "name": "/vehicles/vehicle_00/brake", "channel": "safety"}
POSES, POSE_BYTES, CLOUD_BYTES = 40, 200_000, 320_000
TURNS = 50


@pytest.fixture
def way() -> Iterator[list[Gates]]:
    made: list[Gates] = []
    yield made
    for gates in made:
        gates.close()


@pytest.fixture
def stage(tmp_path: Path, way: list[Gates]) -> Iterator[Stage]:
    def through(port: int) -> int:
        way.append(Gates(port))
        return way[0].port

    with ExitStack() as stack:
        made = stack.enter_context(running(tmp_path, through))
        made.vehicle.configure(out=[POSE, CLOUD, BRAKE])
        made.cloud.configure(**{"in": [POSE, CLOUD, BRAKE]})
        made.ready()
        yield made


def put(stage: Stage, topic: dict[str, str], numbers: range, size: int) -> None:
    stage.vehicle.endpoint(topic).waiting += [message(number, number, size) for number in numbers]
    stage.sent[topic["name"]] = numbers.stop


def congested(stage: Stage, channel: str) -> bool:
    return stage.vehicle.channels[channel].congested


def test_clouds_wait_for_poses_and_poses_for_what_is_safety(stage: Stage, way: list[Gates]) -> None:
    (gates,) = way
    gates.shut = {"vehicle-00-telemetry"}
    put(stage, POSE, range(POSES), POSE_BYTES)
    stage.until(lambda: congested(stage, "telemetry"))
    before = gates.forwarded["bulk"]
    put(stage, CLOUD, range(3), CLOUD_BYTES)
    put(stage, BRAKE, range(5), 200)
    for _ in range(TURNS):
        stage.turn()
    stage.drained(BRAKE)
    assert stage.vehicle.bridge.yielding == {"bulk"}
    assert (gates.forwarded["bulk"], stage.received(CLOUD)) == (before, [])
    assert len(stage.received(POSE)) < POSES
    gates.shut = set()
    for topic in (POSE, CLOUD):
        stage.drained(topic)
    assert stage.received(POSE) == list(range(POSES))
    assert stage.received(CLOUD) == list(range(3))
    assert stage.vehicle.bridge.yielding == set()


def test_clouds_that_do_not_get_through_hold_up_no_pose(stage: Stage, way: list[Gates]) -> None:
    (gates,) = way
    gates.shut = {"vehicle-00-bulk"}
    put(stage, CLOUD, range(3), CLOUD_BYTES)
    stage.until(lambda: congested(stage, "bulk"))
    put(stage, POSE, range(POSES), 200)
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(POSES))
    assert stage.received(CLOUD) == []
