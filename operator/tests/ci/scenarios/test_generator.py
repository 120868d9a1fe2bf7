"""The scenario's data: bags that standard tools read, a scene that is true, distances that cross as often as stated."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from robotkube.robots.bags.adapters.reading import open_bag
from scenarios import definition
from scenarios.generator import bags, checking, messages, routes, scene
from tests.stages.paths import SCENARIOS

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"
QUICK = ("points=4000", "start_distance_m=200", "stop_distance_m=250", "pose_hz=20", "speed_mps=11")


def silent(_: str) -> None:
    """Takes the generator's talk."""


@pytest.fixture(scope="module")
def quick() -> definition.Scenario:
    return definition.load(FOLDER, QUICK, "small")


@pytest.fixture(scope="module")
def made(quick: definition.Scenario, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    return bags.make_bags(quick, tmp_path_factory.mktemp("cache"), silent)


def test_rosbags_reads_every_topic_with_stamps_equal_to_log_times(
    quick: definition.Scenario, made: Mapping[str, Path]
) -> None:
    seconds = routes.duration_seconds(quick.parameters)
    with Reader(made["vehicle-00"]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts == {
            "/vehicles/vehicle_00/pose": seconds * 20,
            "/vehicles/vehicle_00/lidar_center/transform": 1,
            "/vehicles/vehicle_00/lidar_center/pointcloud": seconds * 10,
        }
        for connection, moment, data in reader.messages():
            message = messages.store.deserialize_cdr(data, connection.msgtype)
            assert message.header.stamp.sec * messages.NANOSECONDS + message.header.stamp.nanosec == moment


def test_the_transform_states_the_lidar_s_offset_and_yaw(made: Mapping[str, Path]) -> None:
    with Reader(made["vehicle-01"]) as reader:
        connections = [connection for connection in reader.connections if connection.topic.endswith("transform")]
        [(connection, _, data)] = reader.messages(connections)
    assert connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    message = messages.store.deserialize_cdr(data, connection.msgtype)
    mount = scene.MOUNTS[1]
    translation, rotation = message.transform.translation, message.transform.rotation
    assert (message.header.frame_id, message.child_frame_id) == ("vehicle_01", "vehicle_01/lidar_center")
    assert (translation.x, translation.y, translation.z) == (mount.x, mount.y, mount.z)
    assert 2 * math.atan2(rotation.z, rotation.w) == pytest.approx(mount.yaw)
    assert mount.yaw
    assert mount.x


def test_the_other_vehicle_is_in_the_cloud_where_its_pose_says(
    quick: definition.Scenario, made: Mapping[str, Path]
) -> None:
    """Points marked as vehicle, carried into the other vehicle's frame, lie on its box; some are seen when near."""
    seen = []
    with Reader(made["vehicle-00"]) as reader:
        connections = [connection for connection in reader.connections if connection.topic.endswith("pointcloud")]
        for connection, moment, data in reader.messages(connections):
            message = messages.store.deserialize_cdr(data, connection.msgtype)
            points = message.data.view(np.float32).reshape(-1, 4)
            assert len(points) == message.width >= quick.parameters.points
            time = np.array([moment / messages.NANOSECONDS])
            own, other = (routes.motion(quick.parameters, index, time) for index in (0, 1))
            marked = points[points[:, 3] == np.float32(scene.VEHICLE)]
            seen.append((float(routes.distance(own, other)[0]), len(marked)))
            on_box = _in_box_frame(marked[:, :3].astype(float), own, other)
            half = np.array(scene.VEHICLE_SIZE_M) / 2
            outside = np.abs(on_box - [0, 0, half[2]]) - half
            assert (outside.max(axis=1, initial=-1) < 0.06).all()
            assert (np.abs(outside).min(axis=1, initial=1) < 0.06).all()
    assert all(count > 0 for distance, count in seen if distance < 40)
    assert all(count == 0 for distance, count in seen if distance > 190)


def _in_box_frame(points: np.ndarray, own: routes.Motion, other: routes.Motion) -> np.ndarray:
    """From the lidar's frame over the vehicle's and `map` to the other vehicle's, by the frames' definitions."""
    mount = scene.MOUNTS[0]
    points = _rotated(points, mount.yaw) + np.array([mount.x, mount.y, mount.z])
    points = _rotated(points, own.yaw[0]) + np.array([own.x[0], own.y[0], 0])
    return _rotated(points - np.array([other.x[0], other.y[0], 0]), -other.yaw[0])


def _rotated(points: np.ndarray, angle: float) -> np.ndarray:
    cosine = math.cos(angle)
    sine = math.sin(angle)
    return points @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])


@pytest.mark.parametrize("encounters", [1, 2, 3])
def test_the_pair_meets_as_often_as_asked_and_stays_apart_long_enough(encounters: int) -> None:
    parameters = definition.load(FOLDER, [f"encounters={encounters}"]).parameters
    time = np.arange(0, routes.duration_seconds(parameters), 0.01)
    distance = routes.distance(routes.motion(parameters, 0, time), routes.motion(parameters, 1, time))
    starts = []
    stops = []
    active = False
    for moment, value in zip(time, distance, strict=True):
        if not active and value < parameters.start_distance_m:
            active = starts.append(moment) or True
        elif active and value > parameters.stop_distance_m:
            active = bool(stops.append(moment))
    assert len(starts) == len(stops) == encounters
    assert all(stop - start > 20 for start, stop in zip(starts, stops, strict=True))
    assert all(later - stop >= 15 for stop, later in zip(stops[:-1], starts[1:], strict=True))
    beyond = [
        np.sum((time > stop) & (time < start) & (distance > parameters.stop_distance_m)) * 0.01
        for stop, start in zip(stops[:-1], starts[1:], strict=True)
    ]
    assert all(seconds >= 15 for seconds in beyond)
    assert starts[0] >= 4
    assert time[-1] - stops[-1] >= 17
    assert 5 <= distance.min() <= 10


def test_motion_is_smooth_and_the_others_stay_away() -> None:
    parameters = definition.load(FOLDER).parameters
    time = np.arange(0, routes.duration_seconds(parameters), 0.01)
    paths = [routes.motion(parameters, index, time) for index in range(parameters.vehicles)]
    for path in paths:
        steps = np.hypot(np.diff(path.x), np.diff(path.y)) / 0.01
        assert steps.max() <= parameters.speed_mps + 0.01
        assert np.abs(np.diff(steps)).max() <= 0.06  # 4 m/s2 along the path
        ahead = np.cos(path.yaw[:-1]) * np.diff(path.x) + np.sin(path.yaw[:-1]) * np.diff(path.y)
        assert (ahead > 0).all()
    for path in paths[2:]:
        assert (
            min(routes.distance(path, paths[0]).min(), routes.distance(path, paths[1]).min())
            > parameters.stop_distance_m
        )


def test_the_same_parameters_give_the_same_bytes(
    quick: definition.Scenario, made: Mapping[str, Path], tmp_path: Path
) -> None:
    again = bags.make_bags(quick, tmp_path, silent)
    for agent, folder in made.items():
        for file in sorted(folder.iterdir()):
            assert (
                hashlib.sha256(file.read_bytes()).digest()
                == hashlib.sha256((again[agent] / file.name).read_bytes()).digest()
            )


def test_the_player_reads_the_bag_in_order_with_its_qualities(made: Mapping[str, Path]) -> None:
    bag = open_bag(made["vehicle-00"])
    qualities = {topic.name.rpartition("/")[2]: (topic.durability, topic.reliability) for topic in bag.topics}
    assert qualities == {
        "pose": ("volatile", "reliable"),
        "transform": ("transient_local", "reliable"),
        "pointcloud": ("volatile", "reliable"),
    }
    times = [(moment, messages.stamp_of(data)) for _, moment, data in bag.messages()]
    assert times == sorted(times)
    assert all(moment == stamp for moment, stamp in times)
    bag.close()


def test_bags_are_made_once(quick: definition.Scenario, made: Mapping[str, Path]) -> None:
    folder = made["vehicle-00"].parent
    said = list[str]()
    assert folder.parts[-2:] == ("bags", bags.key(quick.parameters))
    assert bags.make_bags(quick, folder.parents[1], said.append) == made
    assert said == [f"bags: cached in {folder}"]


def test_a_sound_bag_passes(quick: definition.Scenario, made: Mapping[str, Path]) -> None:
    for agent, folder in made.items():
        checking.check_bag(folder, quick, agent)


def test_a_bag_without_the_topic_is_refused(quick: definition.Scenario, made: Mapping[str, Path]) -> None:
    with pytest.raises(
        definition.ScenarioError,
        match=r"vehicle-02\.mcap: topic /vehicles/vehicle_00/pose is missing .* record or rename it",
    ):
        checking.check_bag(made["vehicle-02"], quick, "vehicle-00")


def test_a_bag_off_the_grid_is_refused(quick: definition.Scenario, made: Mapping[str, Path]) -> None:
    slower = definition.load(FOLDER, [*QUICK, "pose_hz=10"], "small")
    with pytest.raises(
        definition.ScenarioError,
        match=r"pose: message 1 has log_time 50000000, .* the grid asks for 100000000; resample",
    ):
        checking.check_bag(made["vehicle-02"], slower, "vehicle-02")


def test_a_bag_of_the_wrong_type_is_refused(
    quick: definition.Scenario, made: Mapping[str, Path], tmp_path: Path
) -> None:
    folder = tmp_path / "vehicle-02"
    folder.mkdir()
    for file in made["vehicle-02"].iterdir():
        (folder / file.name).write_bytes(
            file.read_bytes().replace(b"geometry_msgs/msg/PoseStamped", b"geometry_msgs/msg/PointStampd")
        )
    with pytest.raises(
        definition.ScenarioError, match=r"not a complete MCAP file|has type geometry_msgs/msg/PointStampd; it must be"
    ):
        checking.check_bag(folder, quick, "vehicle-02")


def test_a_bag_cut_short_is_refused(quick: definition.Scenario, made: Mapping[str, Path], tmp_path: Path) -> None:
    folder = tmp_path / "vehicle-02"
    folder.mkdir()
    for file in made["vehicle-02"].iterdir():
        data = file.read_bytes()
        (folder / file.name).write_bytes(data if file.suffix == ".yaml" else data[: len(data) // 2])
    with pytest.raises(definition.ScenarioError, match="not a complete MCAP file"):
        checking.check_bag(folder, quick, "vehicle-02")


def test_a_folder_without_metadata_is_refused(quick: definition.Scenario, tmp_path: Path) -> None:
    with pytest.raises(definition.ScenarioError, match=r"metadata\.yaml: missing"):
        checking.check_bag(tmp_path, quick, "vehicle-02")
