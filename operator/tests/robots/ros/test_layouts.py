"""Fields of random and of real types, from good messages and from bad ones, by definitions good and bad."""

from __future__ import annotations

import random
import sys
import time
import tracemalloc
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from robotkube.robots.ros.core.cdr import BIG_ENDIAN, CdrWriter, Header
from robotkube.robots.ros.core.cdr_readers.readers import NUMBER, SERIES, TEXT, TRUTH, Layouts, UnknownTypeError
from robotkube.robots.ros.core.message_definitions import read_definitions
from tests.stages.examples import EXAMPLES
from tests.stages.ros.random_types import RandomTypes, plain

CASES = [EXAMPLES, pytest.param(5000, marks=pytest.mark.thorough)]
PAYLOADS = [EXAMPLES, pytest.param(20_000, marks=pytest.mark.thorough)]
SHARE = Path(sys.prefix) / "share"
store = get_typestore(Stores.ROS2_JAZZY)

DEFINITIONS = {
    "geometry_msgs/msg/PoseStamped": """std_msgs/Header header
Pose pose
================================================================================
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/msg/Time
int32 sec
uint32 nanosec
""",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "test_msgs/msg/Poses": "Header header\ngeometry_msgs/PoseStamped[] poses\nstring[<=3] names\nbool[2] flags\n",
    "test_msgs/msg/Loop": "Loop[] again\n",
    "test_msgs/msg/Lost": "Missing missing\n",
    "test_msgs/msg/Huge": "Part[4000000000] parts\n===\nMSG: test_msgs/Part\nfloat64[4000000000] numbers\n",
    "test_msgs/msg/Nothing": "# no fields\nuint8 LIMIT=1\n",
}
POSE = "geometry_msgs/msg/PoseStamped"


def layouts() -> Layouts:
    return Layouts(DEFINITIONS.__getitem__)


def pose(frame: str = "map", order: bytes = b"\0\1\0\0") -> bytes:
    writer = CdrWriter(bytearray(order))
    writer.header(Header(1_700_000_000_000_000_005, frame))
    for value in (1.5, -2.0, 3.0, 0.0, 0.0, 0.6, 0.8):
        writer.number("d", value)
    return bytes(writer.data)


@pytest.mark.parametrize("count", CASES)
def test_random_fields_of_random_types_are_read(count: int) -> None:
    """Types with nesting, bounds, constants, defaults and every kind of field, in both byte orders."""
    read = 0
    for seed in range(count):
        types = RandomTypes(seed)
        value = types.one(types.top)
        wanted = [chosen for chosen in (types.path(value) for _ in range(types.draw.randrange(1, 12))) if chosen]
        text = types.text()
        reader = Layouts({"test_msgs/msg/T0": text}.__getitem__).reader(
            "test_msgs/msg/T0", [path for path, _ in wanted]
        )
        for little in (True, False):
            data = types.message(value, little)
            values = reader(memoryview(data) if little else data)
            assert [plain(one) for one in values] == [expected for _, expected in wanted], (seed, wanted, text)
            assert [kind_of(one) for one in values] == list(reader.kinds), (seed, wanted)
            read += len(values)
    assert read > 3 * count


def kind_of(value: Any) -> str:
    if isinstance(value, (array, tuple)):
        return SERIES
    return TRUTH if isinstance(value, bool) else TEXT if isinstance(value, str) else NUMBER


INSTALLED = sorted(
    f"{path.parent.parent.name}/msg/{path.stem}"
    for package in ("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs", "builtin_interfaces")
    for path in (SHARE / package / "msg").glob("*.msg")
    if f"{package}/msg/{path.stem}" in store.types
)


def installed(type_name: str) -> str:
    package, _, name = type_name.split("/")
    try:
        return (SHARE / package / "msg" / f"{name}.msg").read_text()
    except OSError:
        raise KeyError(type_name) from None


@pytest.mark.parametrize("type_name", INSTALLED)
def test_installed_types_are_read_as_the_type_library_writes_them(type_name: str) -> None:
    """Every single field of every installed type: each number of the message is another."""
    message = build(type_name, iter(range(1, 100_000)))
    data = bytes(store.serialize_cdr(message, type_name))
    known = Layouts(installed)
    paths = [path for path in known.fields(type_name) if "[]" not in path]
    for path, value in zip(paths, known.reader(type_name, paths)(data), strict=True):
        expected = message
        for part in path.split("."):
            expected = getattr(expected, part)
        if hasattr(expected, "nanosec"):
            expected = expected.sec * 10**9 + expected.nanosec
        if isinstance(expected, (list, np.ndarray)):
            assert plain(value) == list(expected), path
        else:
            assert value == (pytest.approx(expected) if isinstance(value, float) else expected), path


def build(type_name: str, counter: Any) -> Any:
    """A message of the type library: another number in each field, texts of three letters, two numbers in a series."""
    fields: dict[str, Any] = {}
    for name, (kind, detail) in store.fielddefs[type_name][1]:
        if kind == Nodetype.NAME:
            fields[name] = build(detail, counter)
        elif kind == Nodetype.BASE:
            fields[name] = one(detail[0], counter)
        else:
            (inner, what), length = detail
            count = length if kind == Nodetype.ARRAY else 2
            if inner == Nodetype.NAME:
                fields[name] = [build(what, counter) for _ in range(count)]
            else:
                values = [one(what[0], counter) for _ in range(count)]
                fields[name] = values if what[0] == "string" else np.array(values, what[0])
    return store.types[type_name](**fields) if fields else store.types[type_name]()


def one(base: str, counter: Any) -> Any:
    number = next(counter)
    if base == "string":
        return f"t{number % 90 + 10}"
    if base == "bool":
        return bool(number % 2)
    return float(number) if "float" in base else number % 100


# one by one -----------------------------------------------------------------------------------------------------------


def test_a_pose_by_name() -> None:
    reader = layouts().reader(POSE, ["pose.position.x", "header.frame_id", "header.stamp", "pose.orientation.w"])
    for frame in ("", "m", "map", "a frame"):
        for order in (b"\0\1\0\0", BIG_ENDIAN):
            assert reader(pose(frame, order)) == (1.5, frame, 1_700_000_000_000_000_005, 0.8)
    assert reader.kinds == (NUMBER, TEXT, NUMBER, NUMBER)
    assert reader.codes == ("d", "", "q", "d")


def test_elements_columns_and_the_same_field_twice() -> None:
    writer = CdrWriter()
    writer.header(Header(7, "map"))
    writer.number("I", 2)
    for frame, x in (("left", 1.0), ("r", 2.0)):
        writer.header(Header(10, frame))
        for value in (x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0):
            writer.number("d", value)
    writer.number("I", 1)
    writer.text("one")
    for flag in (True, False):
        writer.number("?", flag)
    paths = ["poses[].pose.position.x", "poses[1].header.frame_id", "names", "flags", "poses[1].header.frame_id"]
    reader = layouts().reader("test_msgs/msg/Poses", [*paths, "header.stamp.nanosec", "header.stamp", "names[0]"])
    column, *others = reader(writer.data)
    assert (column.typecode, list(column)) == ("d", [1.0, 2.0])
    assert others == ["r", ("one",), (True, False), "r", 7, 7, "one"]
    with pytest.raises(ValueError, match=r"the message has 2 elements where \[2\] is read"):
        layouts().reader("test_msgs/msg/Poses", ["poses[2].header.stamp"])(writer.data)


def test_fields_and_stamps_of_types_are_known() -> None:
    known = layouts()
    assert known.fields("test_msgs/msg/Poses")[:3] == ["header.stamp", "header.frame_id", "poses[].header.stamp"]
    assert known.stamp_path(POSE) == "header.stamp"
    assert known.stamp_path("std_msgs/msg/Header") == "stamp"
    assert known.stamp_path("test_msgs/msg/Nothing") == ""
    assert known.reader(POSE, ("header.stamp",)) is known.reader(POSE, ["header.stamp"])


@pytest.mark.parametrize(
    ("type_name", "path", "problem"),
    [
        (POSE, "pose.x", "geometry_msgs/Pose has no field x; it has position, orientation"),
        (POSE, "pose.position", "name one of its fields: position.x, position.y, position.z"),
        (POSE, "pose[0].position.x", r"pose of geometry_msgs/PoseStamped is one value; leave \[0\] away"),
        (POSE, "header.frame_id.x", "frame_id is of type string and has no fields"),
        (POSE, "", "has no field ; it has header, pose"),
        ("test_msgs/msg/Poses", "poses.header.stamp", r"write poses\[\] or poses\[0\]"),
        ("test_msgs/msg/Poses", "poses", r"name one of its fields: poses\[\].header, poses\[\].pose"),
        ("test_msgs/msg/Poses", "flags[2]", "flags has 2 elements"),
        ("test_msgs/msg/Loop", "again", "test_msgs/Loop contains itself"),
        ("test_msgs/msg/Lost", "missing", "nobody has the definition of test_msgs/msg/Missing"),
        ("test_msgs/msg/Huge", "parts[0].numbers[0]", "test_msgs/Huge takes more than"),
        ("Pose", "x", "'Pose' is no message type"),
    ],
)
def test_wrong_paths_are_named(type_name: str, path: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        layouts().reader(type_name, [path])


def test_missing_definitions_are_told_apart_and_all_wrong_paths_named_at_once() -> None:
    with pytest.raises(UnknownTypeError):
        layouts().fields("test_msgs/msg/Other")
    with pytest.raises(ValueError, match=r"no field a; .*no field b"):
        layouts().reader(POSE, ["a", "b"])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("int32", "line 1: 'int32' is neither a field nor a constant"),
        ("\nint32 a\nint32 a", "line 3: a second field a"),
        ("int32[0] a", "an array of 0 elements"),
        ("int32[99999999999] a", "an array of 99999999999 elements"),
        ("int32 a\n====\nint32 b", "does not begin with MSG"),
        ("a/b/c/d e", "neither"),
        ("x" * 1_000_001, "more than 1000000 characters"),
    ],
)
def test_wrong_definitions_are_named(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        read_definitions("test_msgs/msg/T", text)


def test_other_encapsulations_are_refused() -> None:
    with pytest.raises(ValueError, match="encapsulation 0007 is not that of classic CDR"):
        layouts().reader(POSE, ["pose.position.x"])(b"\0\7" + pose()[2:])


# bad input ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", PAYLOADS)
def test_no_payload_crashes_hangs_or_grows(count: int) -> None:
    """Cut off, with lying lengths, of another type, or noise: values or ValueError, at a cost the size accounts for."""
    refused = slowest = 0.0
    most = 0.0
    tracemalloc.start()
    try:
        for seed in range(count):
            types = RandomTypes(seed % 500)
            draw = random.Random(seed)  # noqa: S311 - the same cases every time
            value = types.one(types.top)
            paths = [chosen[0] for chosen in (types.path(value) for _ in range(6)) if chosen]
            reader = Layouts({"test_msgs/msg/T0": types.text()}.__getitem__).reader("test_msgs/msg/T0", paths)
            data = damaged(draw, types.message(value, draw.random() < 0.5))
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            began = time.process_time()
            try:
                reader(data)
            except ValueError:
                refused += 1
            slowest = max(slowest, time.process_time() - began)
            most = max(most, (tracemalloc.get_traced_memory()[1] - before - 20_000) / len(data + b"x"))
    finally:
        tracemalloc.stop()
    assert 0.2 * count < refused < count
    assert slowest < 1
    assert most < 64, "bytes per byte of the message"


def damaged(draw: random.Random, data: bytes) -> bytes:
    kind = draw.choice(["cut", "lie", "lie", "noise", "other"])
    if kind == "cut":
        return data[: draw.randrange(len(data))]
    if kind == "lie":
        changed = bytearray(data)
        for _ in range(draw.randrange(1, 4)):
            place = draw.randrange(4, len(data) + 1) & ~3
            changed[place : place + 4] = draw.choice([b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", draw.randbytes(4)])
        return bytes(changed)
    if kind == "noise":
        return data[: draw.choice([0, 4])] + draw.randbytes(draw.choice([0, 3, 100, 5000]))
    return pose()


@pytest.mark.parametrize(("texts", "outcome"), [(249_000, (False, False)), (260_000, None), (2**32 - 1, None)])
def test_a_megabyte_of_empty_texts_is_passed_or_refused_in_time(texts: int, outcome: tuple[bool, bool] | None) -> None:
    """Zeros are texts of no length, as many as the message says; more than fit are refused before they are counted."""
    reader = layouts().reader("test_msgs/msg/Poses", ["flags"])
    data = bytes([0, 1, 0, 0]) + bytes(16) + texts.to_bytes(4, "little") + bytes(1_000_000)
    began = time.process_time()
    try:
        value = reader(data)[0]
    except ValueError:
        value = None
    assert value == outcome
    assert time.process_time() - began < 2


@pytest.mark.parametrize("count", PAYLOADS)
def test_no_definition_crashes_or_hangs(count: int) -> None:
    """Definitions with lines cut, doubled, mixed and garbled: a reader or ValueError."""
    readable = 0
    for seed in range(count):
        types = RandomTypes(seed % 500)
        draw = random.Random(seed)  # noqa: S311 - the same cases every time
        lines = types.text().splitlines()
        for _ in range(draw.randrange(1, 4)):
            place = draw.randrange(len(lines))
            lines[place] = draw.choice(
                ["", lines[place][: draw.randrange(1 + len(lines[place]))], draw.choice(lines), "T0[] again",
                 "uint8[4294967295] a", "T1[4294967295] b", draw.randbytes(9).decode("latin-1")]
            )  # fmt: skip
        known = Layouts({"test_msgs/msg/T0": "\n".join(lines)}.__getitem__)
        try:
            reader = known.reader("test_msgs/msg/T0", known.fields("test_msgs/msg/T0")[:50])
        except ValueError:
            continue
        readable += 1
        try:
            reader(types.message(types.one(types.top), little=True)) if seed % 2 else reader(bytes(100))
        except (ValueError, KeyError):
            continue
    assert readable > count / 20
