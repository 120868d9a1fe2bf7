"""PointCloud2 in the forms of different lidars: read as they are, or refused in words that are true."""

from __future__ import annotations

import itertools
import struct
from typing import Any

import numpy as np
import pytest

from robotkube.robots.perception.core.point_clouds import KINDS, read_cloud
from scenarios.generator import messages

CODES = {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
         "float32": "f4", "float64": "f8"}  # fmt: skip
NUMBERS = {kind.name: number for number, kind in KINDS.items()}
XYZIRT = [("x", "float32", 0), ("y", "float32", 4), ("z", "float32", 8), ("intensity", "float32", 12),
          ("ring", "uint16", 16), ("time", "float32", 18)]  # fmt: skip
POINTS = 6


def cloud(
    fields: list[tuple[str, str, int]], step: int, height: int = 1, behind: int = 0, big: bool = False, **changes: Any
) -> bytes:
    """A serialised PointCloud2 of POINTS points, field k of point n being 10 * k + n; `behind`: bytes after each
    row."""
    width = POINTS // height
    row_step = width * step + behind
    data = bytearray(b"\xee" * (row_step * height))
    for point in range(POINTS):
        begin = point // width * row_step + point % width * step
        for number, (_, kind, offset) in enumerate(fields):
            value = np.array([10 * number + point], f"{'>' if big else '<'}{CODES[kind]}").tobytes()
            data[begin + offset : begin + offset + len(value)] = value
    types = messages.store.types
    field_type, cloud_type = types["sensor_msgs/msg/PointField"], types[messages.CLOUD_TYPE]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "lidar")
    listed = [field_type(name, offset, NUMBERS[kind], 1) for name, kind, offset in fields]
    values: dict[str, Any] = {
        "header": header, "height": height, "width": width, "fields": listed, "is_bigendian": big, "point_step": step,
        "row_step": row_step, "data": np.frombuffer(bytes(data), np.uint8), "is_dense": True,
    }  # fmt: skip
    return bytes(messages.store.serialize_cdr(cloud_type(**{**values, **changes}), messages.CLOUD_TYPE))


def column(number: int) -> list[float]:
    return [10.0 * number + point for point in range(POINTS)]


@pytest.mark.parametrize(("height", "behind", "big"), itertools.product((1, 2), (0, 5), (False, True)))
def test_a_point_of_22_bytes_is_read(height: int, behind: int, big: bool) -> None:
    """Velodyne's XYZIRT: ring and time after the intensity. It was said not to fit into its bytes."""
    read = read_cloud(cloud(XYZIRT, 22, height, behind, big))
    assert [list(values) for values in (read.x, read.y, read.z, read.intensity)] == [column(n) for n in range(4)]


@pytest.mark.parametrize(("height", "behind"), [(2, 8), (3, 16)])
def test_rows_that_are_longer_than_their_points_are_read(height: int, behind: int) -> None:
    read = read_cloud(cloud(XYZIRT[:4], 16, height, behind))
    assert [list(values) for values in (read.x, read.intensity)] == [column(0), column(3)]


def test_doubles_are_read() -> None:
    fields = [("x", "float64", 0), ("y", "float64", 8), ("z", "float64", 16), ("intensity", "float64", 24)]
    read = read_cloud(cloud(fields, 32))
    assert [list(values) for values in (read.x, read.y, read.z, read.intensity)] == [column(n) for n in range(4)]
    assert {values.typecode for values in (read.x, read.intensity)} == {"f"}


@pytest.mark.parametrize("kind", ["uint8", "uint16", "int16", "uint32"])
def test_whole_numbers_of_intensity_are_shares_of_the_greatest(kind: str) -> None:
    fields = [*XYZIRT[:3], ("intensity", kind, 12)]
    read = read_cloud(cloud(fields, 17))
    greatest = KINDS[NUMBERS[kind]].greatest
    assert list(read.intensity) == pytest.approx([value / greatest for value in column(3)])
    assert list(read.z) == column(2)


def test_a_cloud_without_intensity_is_read() -> None:
    assert not read_cloud(cloud(XYZIRT[:3], 12)).intensity


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            cloud(XYZIRT[3:5], 18),
            "the cloud has no fields x, y, z",
        ),
        (
            cloud([("x", "int16", 0), *XYZIRT[1:4]], 16),
            "field x is int16; x, y and z are read as float32 or float64",
        ),
        (
            cloud([("x", "float32", 0), ("y", "float32", 24), ("z", "float32", 48)], 52, point_step=4, row_step=24),
            "field y at byte 24 lies beyond a point of 4 bytes: fields that are stored one after the other, each for "
            "all points, are not read",
        ),
        (
            cloud(XYZIRT, 22, data=np.zeros(100, np.uint8)),
            "6 points of 22 bytes need 132 bytes, the cloud has 100",
        ),
        (
            cloud(XYZIRT, 22, height=2, row_step=60),
            "3 points of 22 bytes are more than a row of 60 bytes",
        ),
    ],
)  # fmt: skip
def test_what_is_refused_is_said_as_it_is(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=f"^{words}$"):
        read_cloud(data)


def test_a_type_that_nobody_has_is_named() -> None:
    data = bytearray(cloud(XYZIRT[:3], 12))
    place = data.index(struct.pack("<IBxxxI", 0, 7, 1))
    data[place + 4] = 9
    with pytest.raises(ValueError, match="field x has the type 9, which PointField does not have"):
        read_cloud(bytes(data))
