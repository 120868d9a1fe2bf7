"""The messages of the perception services: clouds in, poses and numbers out. Lengths in m, in the frame of the sensor.

sensor_msgs/PointCloud2 is read as far as lidars use it: float32 fields at multiples of four bytes.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robotkube.robots.ros.core.cdr import CdrReader, CdrWriter, Header

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
POSES_TYPE = "geometry_msgs/msg/PoseArray"
NUMBER_TYPE = "std_msgs/msg/Float64"
TEXT_TYPE = "std_msgs/msg/String"

FLOAT32 = 7
FIELDS_MAX = 64
POSES_MAX = 10_000
WORD_BYTES = 4
AXES = ("x", "y", "z")
INTENSITY = "intensity"


@dataclass(frozen=True)
class Cloud:
    """Points as columns of one length; `intensity` is empty when the sensor gives none."""

    header: Header
    x: array[float]
    y: array[float]
    z: array[float]
    intensity: array[float]


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


def read_cloud(data: bytes) -> Cloud:
    """The points of a serialised PointCloud2; ValueError when it is none or has another form than float32."""
    reader = CdrReader(data)
    header = reader.header()
    points = reader.count() * reader.count()
    offsets = _offsets(reader)
    big_endian = bool(reader.number("?"))
    step = reader.count()
    reader.number("I")  # row_step
    words = _words(reader.octets(reader.count()), big_endian)
    if points == 0:
        return Cloud(header, array("f"), array("f"), array("f"), array("f"))
    missing = [axis for axis in AXES if axis not in offsets]
    if missing:
        raise ValueError(f"the cloud has no float32 fields {', '.join(missing)}")
    if step % WORD_BYTES or not step or len(words) < points * step // WORD_BYTES:
        raise ValueError(f"{points} points of {step} bytes do not fit into the cloud's {len(words) * WORD_BYTES} bytes")
    columns = {name: words[offset :: step // WORD_BYTES][:points] for name, offset in offsets.items()}
    return Cloud(header, columns["x"], columns["y"], columns["z"], columns.get(INTENSITY, array("f")))


def _offsets(reader: CdrReader) -> Mapping[str, int]:
    """Place of each float32 field within a point, in words."""
    count = reader.count()
    if count > FIELDS_MAX:
        raise ValueError(f"a point has {count} fields, more than {FIELDS_MAX}")
    offsets = {}
    for _ in range(count):
        name = reader.text()
        offset = reader.count()
        kind = reader.number("B")
        reader.count()  # number of elements
        if kind == FLOAT32 and offset % WORD_BYTES == 0:
            offsets[name] = offset // WORD_BYTES
    return offsets


def _words(data: memoryview, big_endian: bool) -> array[float]:
    words = array("f")
    words.frombytes(data[: len(data) // WORD_BYTES * WORD_BYTES])
    if big_endian != (sys.byteorder == "big"):
        words.byteswap()
    return words


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
