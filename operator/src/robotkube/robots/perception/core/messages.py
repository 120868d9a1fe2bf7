"""The messages of the perception services but clouds: poses, numbers and texts. Lengths in m, in the frame of the
sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robotkube.robots.ros.core.cdr import CdrReader, CdrWriter, Header

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
POSES_TYPE = "geometry_msgs/msg/PoseArray"
NUMBER_TYPE = "std_msgs/msg/Float64"
TEXT_TYPE = "std_msgs/msg/String"

POSES_MAX = 10_000


@dataclass(frozen=True)
class PlanarPose:
    """A place and a heading in rad about the vertical axis."""

    x: float
    y: float
    z: float
    quaternion_z: float = 0.0
    quaternion_w: float = 1.0


@dataclass(frozen=True)
class Poses:
    """A geometry_msgs/PoseArray."""

    header: Header
    poses: tuple[PlanarPose, ...]


def write_poses(header: Header, poses: Sequence[PlanarPose]) -> bytes:
    """A serialised PoseArray."""
    writer = CdrWriter()
    writer.header(header)
    writer.number("I", len(poses))
    for pose in poses:
        for value in (pose.x, pose.y, pose.z, 0.0, 0.0, pose.quaternion_z, pose.quaternion_w):
            writer.number("d", value)
    return bytes(writer.data)


def read_poses(data: bytes) -> Poses:
    """A serialised PoseArray; ValueError when it is none."""
    reader = CdrReader(data)
    header = reader.header()
    count = reader.count()
    if count > POSES_MAX:
        raise ValueError(f"{count} poses are more than {POSES_MAX}")
    poses = []
    for _ in range(count):
        x, y, z, _, _, quaternion_z, quaternion_w = (reader.number("d") for _ in range(7))
        poses.append(PlanarPose(x, y, z, quaternion_z, quaternion_w))
    return Poses(header, tuple(poses))


def write_number(value: float) -> bytes:
    """A serialised std_msgs/Float64."""
    writer = CdrWriter()
    writer.number("d", value)
    return bytes(writer.data)


def write_text(value: str) -> bytes:
    """A serialised std_msgs/String."""
    writer = CdrWriter()
    writer.text(value)
    return bytes(writer.data)
