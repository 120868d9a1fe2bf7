"""Serialised ROS messages (CDR, little endian), made by writing into a template that the type library serialised
once."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from scenarios.generator.scene import Mount

NANOSECONDS = 1_000_000_000
STAMP = struct.Struct("<iI")  # behind the four bytes of the encapsulation: header.stamp
POSE_BODY = struct.Struct("<7d")  # position x, y, z and orientation x, y, z, w end the message
POINT_STEP = 16
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
TRANSFORM_TYPE = "geometry_msgs/msg/TransformStamped"

store = get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class Definition:
    """A message type as a bag states it: name, text of its definition, hash of its type description."""

    name: str
    text: str
    type_hash: str


def definition(type_name: str) -> Definition:
    """Looks a message type up in the ROS 2 Jazzy type library."""
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return Definition(type_name, text, store.hash_rihs01(type_name))


def stamp_of(data: bytes | memoryview) -> int:
    """header.stamp in ns of any serialised message that begins with a Header."""
    seconds, nanoseconds = STAMP.unpack_from(data, 4)
    return int(seconds) * NANOSECONDS + int(nanoseconds)


class PoseWriter:
    """Serialises PoseStamped of frame `map`."""

    def __init__(self) -> None:
        point = _new("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
        pose = _new("geometry_msgs/msg/Pose", position=point, orientation=_quaternion(0.0))
        self._data = bytearray(_serialise(POSE_TYPE, header=_header("map"), pose=pose))

    def message(self, stamp: int, x: float, y: float, yaw: float) -> bytes:
        """A pose on the ground; `stamp` in ns, lengths in m, angle in rad."""
        STAMP.pack_into(self._data, 4, *divmod(stamp, NANOSECONDS))
        POSE_BODY.pack_into(
            self._data, len(self._data) - POSE_BODY.size, x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)
        )
        return bytes(self._data)


class CloudWriter:
    """Serialises PointCloud2 of float32 x, y, z, intensity, all with the same number of points."""

    def __init__(self, frame: str, points: int) -> None:
        fields = [
            _new("sensor_msgs/msg/PointField", name=name, offset=4 * number, datatype=7, count=1)
            for number, name in enumerate(("x", "y", "z", "intensity"))
        ]
        self._bytes = points * POINT_STEP
        self._data = bytearray(
            _serialise(
                CLOUD_TYPE,
                header=_header(frame),
                height=1,
                width=points,
                fields=fields,
                is_bigendian=False,
                point_step=POINT_STEP,
                row_step=self._bytes,
                data=np.zeros(self._bytes, np.uint8),
                is_dense=True,
            )
        )

    def message(self, stamp: int, cloud: NDArray[np.float32]) -> bytes:
        """A cloud from an (n, 4) array; `stamp` in ns."""
        STAMP.pack_into(self._data, 4, *divmod(stamp, NANOSECONDS))
        end = len(self._data) - 1  # is_dense is the last byte
        self._data[end - self._bytes : end] = cloud.tobytes()
        return bytes(self._data)


def transform(stamp: int, parent: str, child: str, mount: Mount) -> bytes:
    """A TransformStamped that says where a lidar sits."""
    translation = _new("geometry_msgs/msg/Vector3", x=mount.x, y=mount.y, z=mount.z)
    body = _new("geometry_msgs/msg/Transform", translation=translation, rotation=_quaternion(mount.yaw))
    return _serialise(TRANSFORM_TYPE, header=_header(parent, stamp), child_frame_id=child, transform=body)


def _new(type_name: str, **fields: Any) -> Any:
    return store.types[type_name](**fields)


def _quaternion(yaw: float) -> Any:
    return _new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def _header(frame: str, stamp: int = 0) -> Any:
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return _new(
        "std_msgs/msg/Header",
        stamp=_new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds),
        frame_id=frame,
    )


def _serialise(type_name: str, **fields: Any) -> bytes:
    return bytes(store.serialize_cdr(_new(type_name, **fields), type_name))
