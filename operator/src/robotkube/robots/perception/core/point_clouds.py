"""Reading sensor_msgs/PointCloud2: x, y, z and intensity of every point, whatever stands beside them. Pure.

x, y and z are float32 or float64 at any place in a point of any length. Intensities may be integers, too: they become
shares of the greatest value of their type, as reflectances are. Rows may be longer than their points. Fields that are
stored one after the other, each for all points, are refused.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from robotkube.robots.ros.core.cdr import CdrReader, Header

FIELDS_MAX = 64
AXES = ("x", "y", "z")
INTENSITY = "intensity"
FLOAT32 = 7


class FieldKind(NamedTuple):
    """A type of PointField: its name, its code for array and its bytes; `greatest`: an integer's greatest value."""

    name: str
    code: str
    size: int
    greatest: int = 0


KINDS = {
    1: FieldKind("int8", "b", 1, 2**7 - 1),
    2: FieldKind("uint8", "B", 1, 2**8 - 1),
    3: FieldKind("int16", "h", 2, 2**15 - 1),
    4: FieldKind("uint16", "H", 2, 2**16 - 1),
    5: FieldKind("int32", "i", 4, 2**31 - 1),
    6: FieldKind("uint32", "I", 4, 2**32 - 1),
    FLOAT32: FieldKind("float32", "f", 4),
    8: FieldKind("float64", "d", 8),
}


@dataclass(frozen=True)
class Cloud:
    """Points as columns of one length; `intensity` is empty when the sensor gives none."""

    header: Header
    x: array[float]
    y: array[float]
    z: array[float]
    intensity: array[float]


class _Field(NamedTuple):
    offset: int
    kind: FieldKind


class _Layout(NamedTuple):
    """How many points in a row, how many rows, bytes from point to point and from row to row."""

    width: int
    height: int
    step: int
    row: int

    @property
    def points(self) -> int:
        return self.width * self.height

    @property
    def contiguous(self) -> bool:
        return self.height <= 1 or self.row in (0, self.width * self.step)


def read_cloud(data: bytes) -> Cloud:
    """The points of a serialised PointCloud2; ValueError when it is none, or says what of its form cannot be read."""
    reader = CdrReader(data)
    header = reader.header()
    height, width = reader.count(), reader.count()
    fields = _fields(reader)
    big_endian = bool(reader.number("?"))
    layout = _Layout(width, height, reader.count(), reader.count())
    octets = reader.octets(reader.count())
    if layout.points == 0:
        return Cloud(header, array("f"), array("f"), array("f"), array("f"))
    _require(fields, layout, len(octets))
    swapped = big_endian != (sys.byteorder == "big")
    columns = _columns(_points_of(octets, layout), fields, layout, swapped)
    return Cloud(header, columns["x"], columns["y"], columns["z"], columns.get(INTENSITY, array("f")))


def _fields(reader: CdrReader) -> Mapping[str, _Field]:
    """The fields that are read, by name."""
    count = reader.count()
    if count > FIELDS_MAX:
        raise ValueError(f"a point has {count} fields, more than {FIELDS_MAX}")
    fields = {}
    for _ in range(count):
        name = reader.text()
        offset = reader.number("I")
        kind = reader.number("B")
        reader.number("I")  # number of elements
        if name in (*AXES, INTENSITY):
            if kind not in KINDS:
                raise ValueError(f"field {name} has the type {kind}, which PointField does not have")
            fields[name] = _Field(int(offset), KINDS[int(kind)])
    return fields


def _require(fields: Mapping[str, _Field], layout: _Layout, size: int) -> None:
    """Check that the points can be read; ValueError says what speaks against it."""
    missing = [axis for axis in AXES if axis not in fields]
    if missing:
        raise ValueError(f"the cloud has no fields {', '.join(missing)}")
    for name, (offset, kind) in fields.items():
        if name in AXES and kind.greatest:
            raise ValueError(f"field {name} is {kind.name}; x, y and z are read as float32 or float64")
        if offset + kind.size > layout.step:
            raise ValueError(
                f"field {name} at byte {offset} lies beyond a point of {layout.step} bytes: fields that are stored one "
                "after the other, each for all points, are not read"
            )
    row = layout.width * layout.step
    if not layout.contiguous and layout.row < row:
        raise ValueError(f"{layout.width} points of {layout.step} bytes are more than a row of {layout.row} bytes")
    needed = row * layout.height if layout.contiguous else layout.row * (layout.height - 1) + row
    if size < needed:
        raise ValueError(f"{layout.points} points of {layout.step} bytes need {needed} bytes, the cloud has {size}")


def _points_of(octets: memoryview, layout: _Layout) -> memoryview:
    """The bytes of all points, without what is behind the points of each row."""
    row = layout.width * layout.step
    if layout.contiguous:
        return octets[: row * layout.height]
    rows = (octets[begin : begin + row] for begin in range(0, layout.row * layout.height, layout.row))
    return memoryview(b"".join(rows))


def _columns(
    octets: memoryview, fields: Mapping[str, _Field], layout: _Layout, swapped: bool
) -> dict[str, array[float]]:
    aligned = layout.step % 4 == 0 and all(kind.code == "f" and offset % 4 == 0 for offset, kind in fields.values())
    if not aligned:
        data = bytes(octets)
        return {name: _column(data, field, layout, swapped) for name, field in fields.items()}
    words = array("f")
    words.frombytes(octets)
    if swapped:
        words.byteswap()
    return {name: words[offset // 4 :: layout.step // 4] for name, (offset, _) in fields.items()}


def _column(data: bytes, field: _Field, layout: _Layout, swapped: bool) -> array[float]:
    """The values of one field of any type at any place, as float32."""
    offset, kind = field
    octets = bytearray(kind.size * layout.points)
    for place in range(kind.size):
        octets[place :: kind.size] = data[offset + place :: layout.step]
    values: array[float] = array(kind.code)
    values.frombytes(octets)
    if swapped:
        values.byteswap()
    if kind.greatest:
        return array("f", [value / kind.greatest for value in values])
    return values if kind.code == "f" else array("f", values)
