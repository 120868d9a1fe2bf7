"""Readers of the few fields that every rule needs, from serialised messages (CDR, as DDS and MQTT batches carry them).

Only what stands at a fixed or nearly fixed place is read, so that a message of 320 KB costs as little as one of 100
bytes. Stamps are integers in ns since 1970, positions metres.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

_LITTLE_HEADER, _BIG_HEADER = struct.Struct("<iI"), struct.Struct(">iI")
_LITTLE_LENGTH, _BIG_LENGTH = struct.Struct("<I"), struct.Struct(">I")
_LITTLE_POSITION, _BIG_POSITION = struct.Struct("<3d"), struct.Struct(">3d")
_LITTLE_POSE, _BIG_POSE = struct.Struct("<7d"), struct.Struct(">7d")
LEAST_SQUARE = 1e-9  # of a quaternion: below, it says nothing
_ENCAPSULATION = 4
LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_FRAME_LENGTH = _ENCAPSULATION + 8

STAMPED_TYPES = frozenset(
    [
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/PointStamped",
        "geometry_msgs/msg/TransformStamped",
        "geometry_msgs/msg/TwistStamped",
        "nav_msgs/msg/Odometry",
        "nav_msgs/msg/Path",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/CameraInfo",
        "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/LaserScan",
        "sensor_msgs/msg/NavSatFix",
        "sensor_msgs/msg/PointCloud2",
    ]
)
"""Types whose first field is std_msgs/Header."""


class PublishOutcome(NamedTuple):
    """The outcome of a call to publish messages: the first `published` of them were sent, `late` of these later than
    allowed. `refusal`: why the middleware did not accept the next one; empty when it did not refuse."""

    published: int
    late: int
    refusal: str = ""


def header_stamp(data: bytes) -> int:
    """The header's stamp of a serialised message of one of STAMPED_TYPES; ValueError when it is too short."""
    try:
        seconds: int
        nanoseconds: int
        seconds, nanoseconds = (_LITTLE_HEADER if data[1] & 1 else _BIG_HEADER).unpack_from(data, _ENCAPSULATION)
    except (struct.error, IndexError) as error:
        raise ValueError(f"a message of {len(data)} bytes has no header") from error
    return seconds * 1_000_000_000 + nanoseconds


def pose_position(data: bytes) -> tuple[float, float, float]:
    """x, y, z of a serialised PoseStamped; ValueError when the message is too short."""
    little = data[1] & 1 if len(data) > 1 else 1
    try:
        (length,) = (_LITTLE_LENGTH if little else _BIG_LENGTH).unpack_from(data, _FRAME_LENGTH)
        x, y, z = (_LITTLE_POSITION if little else _BIG_POSITION).unpack_from(data, _pose_start(length))
    except struct.error as error:
        raise ValueError(f"a message of {len(data)} bytes is no PoseStamped") from error
    return x, y, z


def pose_and_heading(data: bytes) -> tuple[float, float, float, float | None]:
    """x, y, z and the heading (yaw in radians, counter-clockwise from the x axis) of a serialised PoseStamped; the
    heading is None when the orientation is none. ValueError when the message is too short, or has a number that is not
    finite."""
    little = data[1] & 1 if len(data) > 1 else 1
    try:
        (length,) = (_LITTLE_LENGTH if little else _BIG_LENGTH).unpack_from(data, _FRAME_LENGTH)
        values = (_LITTLE_POSE if little else _BIG_POSE).unpack_from(data, _pose_start(length))
    except struct.error as error:
        raise ValueError(f"a message of {len(data)} bytes is no PoseStamped") from error
    if not all(map(math.isfinite, values)):
        raise ValueError("a pose with a number that is not finite")
    x, y, z, qx, qy, qz, qw = values
    square = qx * qx + qy * qy + qz * qz + qw * qw
    heading = None if square < LEAST_SQUARE else math.atan2(2 * (qw * qz + qx * qy), square - 2 * (qy * qy + qz * qz))
    return x, y, z, heading


def _pose_start(frame_length: int) -> int:
    """The offset at which a pose begins behind a header; doubles are aligned to 8 bytes, counted after the
    encapsulation."""
    return _ENCAPSULATION + (_FRAME_LENGTH - _ENCAPSULATION + 4 + frame_length + 7) // 8 * 8


def string_text(data: bytes) -> bytes:
    """The text of a serialised std_msgs/String without its end mark; ValueError when the message is cut off."""
    little = data[1] & 1 if len(data) > 1 else 1
    try:
        (length,) = (_LITTLE_LENGTH if little else _BIG_LENGTH).unpack_from(data, _ENCAPSULATION)
    except struct.error as error:
        raise ValueError(f"a message of {len(data)} bytes is no String") from error
    begin = _ENCAPSULATION + _LITTLE_LENGTH.size
    if begin + length > len(data):
        raise ValueError(f"a message of {len(data)} bytes ends before its text of {length} bytes")
    return data[begin : begin + length].removesuffix(b"\0")


def string_message(text: bytes) -> bytes:
    """A serialised std_msgs/String; what is no UTF-8 in `text` is replaced, since ROS reads nothing else."""
    encoded = text.decode(errors="replace").encode() + b"\0"
    return LITTLE_ENDIAN + _LITTLE_LENGTH.pack(len(encoded)) + encoded
