"""The uncertainty of labels: of the poses' covariance where they have one, otherwise as it is given."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from robotkube.robots.export.core.labels import Label, LabellingSettings
from robotkube.robots.export.core.transforms import Deviation, deviation
from robotkube.robots.export.loops.labelling import LabellingCounts, label_clouds
from robotkube.robots.perception.core.messages import CLOUD_TYPE
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from scenarios.generator import messages
from tests.stages.ros import lidar_clouds

STORE = get_typestore(Stores.ROS2_JAZZY)
LAYOUTS = Layouts(lambda name: STORE.generate_msgdef(name, ros_version=2)[0])
PLAIN, COVARIANT, ODOMETRY = (
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry",
)  # fmt: skip
MOUNT = "geometry_msgs/msg/TransformStamped"
SECOND_NS = 1_000_000_000
DISTANCE_M = 30.0
GIVEN = LabellingSettings(pose_sigma_m=0.5, heading_sigma_rad=0.05)


def covariance(position_m: float, heading_rad: float) -> list[float]:
    """Along y the position is known best."""
    covariance = [0.0] * 36
    covariance[0] = covariance[14] = position_m**2
    covariance[7] = position_m**2 / 4
    covariance[35] = heading_rad**2
    return covariance


def make(name: str, **fields: Any) -> Any:
    return STORE.types[name](**fields)


def header(stamp: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(stamp, SECOND_NS)
    time = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def pose(type_name: str, stamp: int, x: float, values: list[float]) -> bytes:
    """A serialised message of any of the three types."""
    place = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=x, y=0.0, z=0.0),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    fields: dict[str, Any] = {"header": header(stamp, "map"), "pose": place}
    if type_name != PLAIN:
        fields["pose"] = make("geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=np.array(values))
    if type_name == ODOMETRY:
        zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        still = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        fields["child_frame_id"] = "body"
        fields["twist"] = make("geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=np.zeros(36))
    return bytes(STORE.serialize_cdr(make(type_name, **fields), type_name))


class Bag:
    """Port BagSource: vehicle-00 with a lidar, vehicle-01 in front of it; poses every 100 ms, a cloud at `stamp`."""

    def __init__(self, types: tuple[str, str], covariances: tuple[list[float], list[float]], stamp: int) -> None:
        self.types: Mapping[str, str] = {
            "/vehicles/vehicle_00/pose": types[0],
            "/vehicles/vehicle_01/pose": types[1],
            "/cloud": CLOUD_TYPE,
            "/mount": MOUNT,
        }
        mount = messages.transform(0, "vehicle_00", lidar_clouds.FRAME, lidar_clouds.MOUNT)
        self._messages = [("/mount", 0, mount)]
        for at in (SECOND_NS, SECOND_NS + SECOND_NS // 10):
            for number in (0, 1):
                # the second pose of vehicle-01 is twice as uncertain as its first
                factor = 4.0 if number and at > SECOND_NS else 1.0
                values = [value * factor for value in covariances[number]]
                data = pose(types[number], at, DISTANCE_M * number, values)
                self._messages.append((f"/vehicles/vehicle_0{number}/pose", at, data))
        self._messages.append(("/cloud", stamp, lidar_clouds.cloud(stamp=stamp, points=100)))

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        return iter([message for message in self._messages if wanted is None or message[0] in wanted])


def label(
    types: tuple[str, str] = (COVARIANT, ODOMETRY),
    own: list[float] | None = None,
    other: list[float] | None = None,
    between: bool = False,
) -> Label:
    """Of the one cloud, taken at a pose or between two."""
    known = own or covariance(0.1, 0.01), other or covariance(0.3, 0.02)
    bag = Bag(types, known, SECOND_NS + between * SECOND_NS // 20)
    counts = LabellingCounts()
    (labelled,) = label_clouds(bag, LAYOUTS, GIVEN, counts)
    (only,) = labelled.labels
    assert counts.unreadable == 0
    return only


def expected(vehicle: Label, own: Deviation, other: Deviation) -> tuple[float, float]:
    """At the stamp of a pose, where nothing is interpolated."""
    position = math.hypot(own.position_m, other.position_m, own.heading_rad * vehicle.distance_m)
    return pytest.approx(position), pytest.approx(math.hypot(own.heading_rad, other.heading_rad))


STATED = Deviation(GIVEN.pose_sigma_m, GIVEN.heading_sigma_rad)


@pytest.mark.parametrize("own", [COVARIANT, ODOMETRY])
@pytest.mark.parametrize("other", [COVARIANT, ODOMETRY])
def test_both_poses_covariances_are_the_labels(own: str, other: str) -> None:
    vehicle = label((own, other))
    assert (vehicle.position_uncertainty_m, vehicle.heading_uncertainty_rad) == expected(
        vehicle, Deviation(0.1, 0.01), Deviation(0.3, 0.02)
    )


def test_a_pose_without_covariance_has_what_is_given() -> None:
    vehicle = label((PLAIN, ODOMETRY))
    assert (vehicle.position_uncertainty_m, vehicle.heading_uncertainty_rad) == expected(
        vehicle, STATED, Deviation(0.3, 0.02)
    )
    vehicle = label((PLAIN, PLAIN))
    assert (vehicle.position_uncertainty_m, vehicle.heading_uncertainty_rad) == expected(vehicle, STATED, STATED)


@pytest.mark.parametrize("unknown", [[0.0] * 36, [-1.0, *[0.0] * 35], [math.nan] * 36])
def test_a_covariance_that_says_nothing_is_none(unknown: list[float]) -> None:
    vehicle = label(other=unknown)
    assert (vehicle.position_uncertainty_m, vehicle.heading_uncertainty_rad) == expected(
        vehicle, Deviation(0.1, 0.01), STATED
    )


def test_between_two_poses_the_larger_one_counts_and_what_interpolation_may_be_wrong() -> None:
    vehicle = label(between=True)
    turn = 3.0 * 0.1**2 / 8
    assert vehicle.heading_uncertainty_rad == pytest.approx(math.hypot(0.01, turn, 0.04, turn))
    move = 10.0 * 0.1**2 / 8
    own_turn = math.hypot(0.01, turn) * vehicle.distance_m
    assert vehicle.position_uncertainty_m == pytest.approx(math.hypot(0.1, 0.6, move, move, own_turn))


def test_axes_that_vary_together_make_no_label_too_sure() -> None:
    """The largest axis of a random covariance is at most what is said, and not more than its rows allow."""
    random = np.random.default_rng(1)
    for _ in range(200):
        part = random.normal(size=(6, 6))
        matrix = part @ part.T
        bound = deviation(matrix.ravel().tolist())
        assert bound is not None
        largest = math.sqrt(np.linalg.eigvalsh(matrix[:3, :3])[-1])
        assert largest <= bound.position_m * (1 + 1e-9) <= math.sqrt(3) * largest * (1 + 1e-6)
        assert bound.heading_rad == pytest.approx(math.sqrt(matrix[5, 5]))
    assert deviation([1.0] * 9) is None
