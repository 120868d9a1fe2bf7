"""Single numbers in messages of standard types, for rules that compare one: `pose.position.x`, `percentage`, `data`.

A layout lists a type's leading fields in order: a code of `struct` with a name, or `header`. What follows the
last field is not read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from robotkube.domain.cdr import CdrReader

_HEADER = ("header", "header")


def _numbers(code: str, *names: str) -> Sequence[tuple[str, str]]:
    return [(code, name) for name in names]


def _vector(path: str) -> Sequence[tuple[str, str]]:
    return _numbers("d", f"{path}.x", f"{path}.y", f"{path}.z")


_POSE = [*_vector("pose.position"), *_numbers("d", *(f"pose.orientation.{axis}" for axis in "xyzw"))]

LAYOUTS: Mapping[str, Sequence[tuple[str, str]]] = MappingProxyType(
    {
        "std_msgs/msg/Bool": _numbers("?", "data"),
        "std_msgs/msg/Float32": _numbers("f", "data"),
        "std_msgs/msg/Float64": _numbers("d", "data"),
        "std_msgs/msg/Int32": _numbers("i", "data"),
        "std_msgs/msg/Int64": _numbers("q", "data"),
        "std_msgs/msg/UInt32": _numbers("I", "data"),
        "std_msgs/msg/UInt64": _numbers("Q", "data"),
        "geometry_msgs/msg/PoseStamped": [_HEADER, *_POSE],
        "geometry_msgs/msg/PointStamped": [_HEADER, *_vector("point")],
        "geometry_msgs/msg/TwistStamped": [_HEADER, *_vector("twist.linear"), *_vector("twist.angular")],
        "sensor_msgs/msg/BatteryState": [
            _HEADER,
            *_numbers("f", "voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage"),
        ],
        "sensor_msgs/msg/FluidPressure": [_HEADER, *_numbers("d", "fluid_pressure", "variance")],
        "sensor_msgs/msg/Illuminance": [_HEADER, *_numbers("d", "illuminance", "variance")],
        "sensor_msgs/msg/RelativeHumidity": [_HEADER, *_numbers("d", "relative_humidity", "variance")],
        "sensor_msgs/msg/Temperature": [_HEADER, *_numbers("d", "temperature", "variance")],
    }
)
"""Type -> its leading fields."""


def number_fields(type_name: str) -> tuple[str, ...]:
    """The numbers of a type that can be read; none for an unknown type."""
    return tuple(path for code, path in LAYOUTS.get(type_name, ()) if code != "header")


def number_in(type_name: str, path: str, data: bytes) -> float:
    """The number at `path` of a serialised message; ValueError when the message is too short."""
    reader = CdrReader(data)
    for code, name in LAYOUTS[type_name]:
        if code == "header":
            reader.header()
            continue
        value = reader.number(code)
        if name == path:
            return float(value)
    raise ValueError(f"{type_name} has no number {path}")
