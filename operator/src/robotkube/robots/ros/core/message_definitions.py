"""ROS message definitions as text (`ros2msg`: a type, then the types it uses behind `MSG: package/Name`) as fields.

Constants and default values are recognised and left out: neither is in a serialised message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from robotkube.foundation.documents.core.patterns import ROS_WORD

DEFINITION_CHARACTERS_MAX = 1_000_000
ARRAY_COUNT_MAX = 2**32 - 1
SINGLE, ARRAY, SEQUENCE = "single", "array", "sequence"

_WORD = ROS_WORD.pattern
_LINE = re.compile(
    rf"(?P<type>{_WORD}(?:/{_WORD}){{0,2}})(?:<=\d+)?"
    rf"(?P<array>\[(?P<bound><=)?(?P<count>\d*)\])?\s+(?P<name>{_WORD})(?P<rest>\s*=.*|\s.*)?"
)
_SEPARATOR = re.compile(r"^={3,}\s*$", re.MULTILINE)
_HEADING = re.compile(r"\s*MSG:\s*(\S+)[^\n]*")

BUILT_IN = frozenset(
    [
        *("bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
        *("float32", "float64", "string", "wstring"),
    ]
)


@dataclass(frozen=True, slots=True)
class Field:
    """A field: `type` is one of BUILT_IN or `package/Name`. `count`: of a fixed array, else 0."""

    name: str
    type: str
    kind: str = SINGLE
    count: int = 0


PLACEHOLDER_FIELD = Field("structure_needs_at_least_one_member", "uint8")
"""What a type without fields is made of, in every serialised message."""

Definitions = Mapping[str, tuple[Field, ...]]
"""`package/Name` -> its fields, never none."""


def short_name(type_name: str) -> str:
    """`package/Name` of `package/msg/Name` or of itself; ValueError for anything else."""
    package, _, name = type_name.partition("/")
    name = name.removeprefix("msg/")
    if not ROS_WORD.fullmatch(package) or not ROS_WORD.fullmatch(name):
        raise ValueError(f"{type_name!r} is no message type such as std_msgs/msg/Header")
    return f"{package}/{name}"


def read_definitions(type_name: str, text: str) -> Definitions:
    """The definition of a type with those that stand behind it; ValueError names the type, the line and the fault."""
    if len(text) > DEFINITION_CHARACTERS_MAX:
        raise ValueError(f"{type_name}: its definition has more than {DEFINITION_CHARACTERS_MAX} characters")
    first, *others = _SEPARATOR.split(text)
    parts = {short_name(type_name): first}
    for other in others:
        heading = _HEADING.match(other)
        if heading is None:
            raise ValueError(f"{type_name}: a part of its definition does not begin with MSG: package/Name")
        parts.setdefault(short_name(heading[1]), other[heading.end() :])
    return {name: tuple(_fields(name, part, parts)) or (PLACEHOLDER_FIELD,) for name, part in parts.items()}


def _fields(owner: str, text: str, parts: Mapping[str, str]) -> Iterator[Field]:
    names: set[str] = set()
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        match = _LINE.fullmatch(content)
        if match is None:
            raise ValueError(f"{owner}, line {number}: {content[:80]!r} is neither a field nor a constant")
        if (match["rest"] or "").lstrip().startswith("="):
            continue
        if match["name"] in names:
            raise ValueError(f"{owner}, line {number}: a second field {match['name']}")
        names.add(match["name"])
        kind, count = _extent(match, f"{owner}, line {number}")
        yield Field(match["name"], _full_type(match["type"], owner, parts), kind, count)


def _extent(match: re.Match[str], where: str) -> tuple[str, int]:
    if match["array"] is None:
        return SINGLE, 0
    if match["bound"] or not match["count"]:
        return SEQUENCE, 0
    count = int(match["count"]) if len(match["count"]) < 12 else ARRAY_COUNT_MAX + 1
    if not 1 <= count <= ARRAY_COUNT_MAX:
        raise ValueError(f"{where}: an array of {match['count']} elements; 1 to {ARRAY_COUNT_MAX} are possible")
    return ARRAY, count


def _full_type(name: str, owner: str, parts: Mapping[str, str]) -> str:
    if name in BUILT_IN:
        return name
    if "/" in name:
        return short_name(name)
    beside = f"{owner.partition('/')[0]}/{name}"
    return "std_msgs/Header" if name == "Header" and beside not in parts else beside
