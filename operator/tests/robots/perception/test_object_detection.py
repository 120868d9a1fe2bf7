"""object-detection: what it finds in the generator's clouds, and that nothing is found where nothing is."""

from __future__ import annotations

import contextlib
import math
import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.errors import DocumentError
from robotkube.robots.perception.core.detection import (
    REFLECTANCE,
    SIZE,
    DetectedObject,
    ObjectCriteria,
    find_objects,
    uncertainty,
)
from robotkube.robots.perception.core.detection_settings import read_detection_settings
from robotkube.robots.perception.core.messages import PlanarPose, read_poses, write_poses
from robotkube.robots.perception.core.point_clouds import read_cloud
from robotkube.robots.perception.loops.object_detection import ObjectDetection
from scenarios.generator import messages, scene
from tests.stages.bridge.memory_network import Network
from tests.stages.ros import lidar_clouds

OLDER, NEWER = ObjectCriteria(SIZE, range_m=25), ObjectCriteria(REFLECTANCE, range_m=60)
DOCUMENT = {
    "cloud": "/v/cloud",
    "objects": "/v/objects",
    "uncertainty": "/v/uncertainty",
    "method": REFLECTANCE,
    "rangeMetres": 60,
    "pointsMin": 4,
}


def test_a_cloud_is_read_as_it_was_written() -> None:
    data = lidar_clouds.cloud(stamp=1_234_000_000_567)
    cloud = read_cloud(data)
    assert (cloud.header.stamp, cloud.header.frame) == (1_234_000_000_567, lidar_clouds.FRAME)
    message = messages.store.deserialize_cdr(data, messages.CLOUD_TYPE)
    words = struct.unpack(f"<{len(message.data) // 4}f", message.data.tobytes())
    assert list(cloud.x) == list(words[0::4])
    assert list(cloud.z) == list(words[2::4])
    assert list(cloud.intensity) == list(words[3::4])


def test_poses_are_written_as_ros_reads_them() -> None:
    header = read_cloud(lidar_clouds.cloud(stamp=7_000_000_001)).header
    pose = PlanarPose(1.5, -2.5, 0.5, 0.6, 0.8)
    data = write_poses(header, [pose, pose])
    message = messages.store.deserialize_cdr(data, "geometry_msgs/msg/PoseArray")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 1)
    assert message.header.frame_id == lidar_clouds.FRAME
    assert [(p.position.x, p.orientation.w) for p in message.poses] == [(1.5, 0.8), (1.5, 0.8)]
    assert read_poses(data).poses == (pose, pose)


@pytest.mark.parametrize(("criteria", "error_m"), [(OLDER, 0.5), (NEWER, 1.5)])
def test_the_box_is_found_as_far_as_is_promised(criteria: ObjectCriteria, error_m: float) -> None:
    for x in [*range(-int(criteria.range_m) + 3, -5, 4), *range(6, int(criteria.range_m) - 4, 4)]:
        other = scene.Place(float(x), 4.0, math.pi)
        objects = find_objects(read_cloud(lidar_clouds.cloud(other, seed=x + 100)), criteria)
        assert len(objects) == 1, x
        assert math.dist((objects[0].pose.x, objects[0].pose.y), lidar_clouds.seen_at(other)) <= error_m, x


@pytest.mark.parametrize("criteria", [OLDER, NEWER])
def test_nothing_is_found_where_nothing_is(criteria: ObjectCriteria) -> None:
    for x in range(0, 60, 3):
        own = scene.Place(float(x), -4.0, 0.0)
        assert find_objects(read_cloud(lidar_clouds.cloud(own=own, seed=x)), criteria) == ()


def beside(gap_m: float, x: float) -> tuple[scene.Place, scene.Place]:
    """Two vehicles beside each other, on the side of the road that is on the left as one looks."""
    width = scene.VEHICLE_SIZE_M[1]
    near = -4.0 if x > 0 else 2.0
    return scene.Place(x, near, math.pi), scene.Place(x, near - width - gap_m, math.pi)


def test_vehicles_beside_each_other_are_two() -> None:
    """They were merged, and one of that size is no vehicle: of the 40 pairs from 2 m on none was found."""
    gaps = (1.5, 2.0, 2.5, 3.0, 3.5)
    pairs = [beside(gap, sign * x) for gap in gaps for x in (8, 15, 25, 35, 45) for sign in (1, -1)]
    assert sum(both_found(pair, NEWER) for pair in pairs) == len(pairs) == 50


@pytest.mark.parametrize(("criteria", "farthest"), [(OLDER, 20), (NEWER, 40)])
def test_lines_of_their_roofs_are_no_vehicles(criteria: ObjectCriteria, farthest: int) -> None:
    """Pairs 1.5 m apart are taken apart over short ways; what came off with them was a third vehicle."""
    pairs = [beside(1.5, float(sign * x)) for x in range(10, farthest + 1, 2) for sign in (1, -1)]
    assert [pair for pair in pairs if not both_found(pair, criteria)] == []


def both_found(pair: tuple[scene.Place, scene.Place], criteria: ObjectCriteria) -> bool:
    """Return whether there are two vehicles, where these are."""
    objects = find_objects(read_cloud(lidar_clouds.cloud(*pair, seed=7)), criteria)
    places = [(detected.pose.x, detected.pose.y) for detected in objects]
    distances = [min((math.dist(lidar_clouds.seen_at(one), place) for place in places), default=99.0) for one in pair]
    return len(objects) == 2 and max(distances) <= 1.5


def test_a_turned_vehicle_has_its_heading() -> None:
    other = scene.Place(12.0, 0.0, math.radians(60))
    [detected] = find_objects(read_cloud(lidar_clouds.cloud(other)), NEWER)
    heading = 2 * math.atan2(detected.pose.quaternion_z, detected.pose.quaternion_w)
    deviation = (heading - (other.yaw - lidar_clouds.MOUNT.yaw) + math.pi / 2) % math.pi - math.pi / 2
    assert abs(math.degrees(deviation)) < 6


def test_fewer_points_are_less_certain() -> None:
    near, far = (
        find_objects(read_cloud(lidar_clouds.cloud(scene.Place(x, 4.0, math.pi))), NEWER) for x in (10.0, 50.0)
    )
    assert uncertainty(near) < 0.1 < uncertainty(far) < 0.5
    assert uncertainty([*near, *far]) == uncertainty(far)
    assert uncertainty([DetectedObject(PlanarPose(0, 0, 0), 100)]) == 0.1
    assert uncertainty([]) == 0


def test_without_intensity_nothing_reflects() -> None:
    cloud = read_cloud(lidar_clouds.cloud(scene.Place(12.0, 4.0, math.pi)))
    assert find_objects(replace(cloud, intensity=cloud.intensity[:0]), NEWER) == ()


def configured(**changes: Any) -> tuple[ObjectDetection, Network]:
    network = Network()
    detection = ObjectDetection(network, lambda *_, **__: None)
    detection.configure(read_detection_settings({**DOCUMENT, **changes}, "config.yaml"))
    return detection, network


def test_every_cloud_gives_poses_and_an_uncertainty() -> None:
    detection, network = configured()
    clouds = [lidar_clouds.cloud(stamp=5), lidar_clouds.cloud(scene.Place(12.0, 4.0, math.pi), stamp=6)]
    network.endpoint("/v/cloud").waiting += clouds
    assert detection.processor.turn() == 2
    answers = [read_poses(data) for data in network.endpoint("/v/objects").published]
    assert [(poses.header.stamp, len(poses.poses)) for poses in answers] == [(5, 0), (6, 1)]
    first, second = (data[4:] for data in network.endpoint("/v/uncertainty").published)
    assert struct.unpack("<d", first) == (0.0,)
    assert 0 < struct.unpack("<d", second)[0] < 0.1
    assert detection.processor.complaint is None


def test_an_empty_message_gives_an_empty_answer() -> None:
    header = bytes([0, 1, 0, 0]) + bytes(8) + struct.pack("<I4s", 1, b"")
    empty = header + bytes(12) + bytes(4) + bytes(8) + bytes(4) + bytes(4)
    assert messages.store.deserialize_cdr(empty, messages.CLOUD_TYPE).width == 0
    detection, network = configured()
    network.endpoint("/v/cloud").waiting += [empty]
    detection.processor.turn()
    assert [read_poses(data).poses for data in network.endpoint("/v/objects").published] == [()]


def test_what_cannot_be_read_is_counted_and_left_out() -> None:
    detection, network = configured()
    network.endpoint("/v/cloud").waiting += [b"", lidar_clouds.cloud()[:5000], lidar_clouds.cloud()]
    detection.processor.turn()
    assert len(network.endpoint("/v/objects").published) == 1
    assert "detection_received_messages_total 3" in detection.processor.metrics()
    assert "detection_malformed_messages_total 2" in detection.processor.metrics()


def test_new_settings_open_topics_anew_only_when_they_changed() -> None:
    detection, network = configured()
    detection.configure(read_detection_settings({**DOCUMENT, "rangeMetres": 10}, "config.yaml"))
    assert len(network.made) == 3
    network.endpoint("/v/cloud").waiting += [lidar_clouds.cloud(scene.Place(30.0, 4.0, math.pi))]
    detection.processor.turn()
    assert [read_poses(data).poses for data in network.endpoint("/v/objects").published] == [()]
    detection.configure(read_detection_settings({**DOCUMENT, "cloud": "/w/cloud"}, "config.yaml"))
    assert [one.closed for one in network.made] == [True, True, True, False, False, False]
    assert network.endpoint("/w/cloud")


@given(st.integers(0, 400), st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=20))
def test_damaged_clouds_are_refused_or_read(length: int, changes: list[tuple[int, int]]) -> None:
    data = bytearray(lidar_clouds.cloud(points=32)[: length + 300])
    for place, value in changes:
        data[place % len(data)] = value
    with contextlib.suppress(ValueError):  # nothing else may be raised
        assert len(find_objects(read_cloud(bytes(data)), NEWER)) <= 1


def test_settings_are_refused_with_every_problem() -> None:
    with pytest.raises(DocumentError) as raised:
        read_detection_settings({**DOCUMENT, "method": "guess", "rangeMetres": 0, "objects": "/v/cloud", "x": 1}, "f")
    text = str(raised.value)
    for part in ("method: 'guess'", "rangeMetres: 0 must be", "objects: /v/cloud has another use", "x: unknown key"):
        assert part in text
