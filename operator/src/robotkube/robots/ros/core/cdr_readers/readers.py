"""Fields of any message type, read straight from the serialised bytes (CDR) by the type's definition.

`Layouts.reader` turns field paths into a program that goes through a message once and reads the requested fields; what
stands behind the last of them is not read. Consecutive values of fixed size are one `struct` read,
whatever is skipped between them. Classic CDR as Fast DDS and the ROS 2 type supports write it: values stand at a
multiple of their size (at most 8) counted from the end of the encapsulation, in either byte order; an empty sequence
has no alignment of its elements; a wstring is its number of UTF-16 units and 4 bytes for each.

A path names fields by dots: `pose.position.x`, `status[0].level` (that element; a message without it is not read),
`poses[].position.x` (of every element), `ranges` (all elements), `header.stamp` (a Time or Duration: ns).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import Any

from robotkube.robots.ros.core.cdr import ENCAPSULATION
from robotkube.robots.ros.core.cdr_readers.compiler import (
    NUMBER,
    SERIES,
    TEXT,
    TRUTH,
    Compiler,
    FieldSelection,
    Leaf,
    add_path,
)
from robotkube.robots.ros.core.cdr_readers.sizes import CODES, TEXTS, TIMES, DefinitionStore, Shapes, UnknownTypeError
from robotkube.robots.ros.core.cdr_readers.steps import ReadRun, Step
from robotkube.robots.ros.core.message_definitions import SINGLE, short_name

__all__ = ["NUMBER", "SERIES", "TEXT", "TRUTH", "FieldReader", "Layouts", "UnknownTypeError"]

Steps = Sequence[Step]
PATHS_MAX = 1000
_NOTHING: list[Any] = []
FIELDS_LISTED_MAX = 500


class FieldReader:
    """Reads the values of `paths` from a serialised message of `type`. May be used by several threads at once.

    `kinds`, one per path: NUMBER (int, float), TRUTH (bool), TEXT (str) or SERIES (array.array of numbers, tuple of
    anything else). `codes`: the code of `struct` (and `array`) for a number, `?` for a bool, else empty.
    """

    __slots__ = ("_orders", "_results", "_slots", "codes", "kinds", "paths", "type")

    def __init__(self, type_name: str, paths: Sequence[str], leaves: Sequence[Leaf], steps: Sequence[Steps]) -> None:
        """`steps`: for big and for little endian messages."""
        self.type = type_name
        self.paths = tuple(paths)
        self.kinds = tuple(leaf.kind for leaf in leaves)
        self.codes = tuple(leaf.code for leaf in leaves)
        slots = [leaf.slot for leaf in leaves]
        self._slots = max(slots, default=-1) + 1
        in_order = slots == list(range(self._slots))
        self._results = None if in_order else itemgetter(*slots, 0)
        self._orders = tuple(_split(program, self._slots if in_order else 0) for program in steps)

    def __call__(self, data: bytes | memoryview) -> tuple[Any, ...]:
        """The values, in the order of the paths; ValueError when the message is cut off or of another type.

        Time and memory are bounded by the message's length, whatever the lengths written in it say.
        """
        try:
            if data[0] or data[1] > 1:
                raise ValueError(f"encapsulation {bytes(data[:2]).hex()} is not that of classic CDR (0000 or 0001)")
            steps, structs = self._orders[data[1]]
            out = _NOTHING if structs is not None else [None] * self._slots  # nothing but the last step reads then
            position = ENCAPSULATION
            for step in steps:
                position = step(data, position, out)
            if structs is not None:
                values: tuple[Any, ...] = structs[position & 7].unpack_from(data, position)
                return values
        except (struct.error, IndexError, ValueError) as error:
            raise ValueError(f"{len(data)} bytes are no {self.type}: {error}") from error
        return tuple(out) if self._results is None else tuple(self._results(out)[:-1])


def _split(steps: Steps, slots: int) -> tuple[Steps, tuple[struct.Struct, ...] | None]:
    """The steps without the last one, and the reads of that one when it gives all values in order.

    Its values then are the result as they are."""
    last = steps[-1] if steps else None
    if slots and isinstance(last, ReadRun) and last.slots == tuple(range(slots)):
        return steps[:-1], last.structs
    return steps, None


class Layouts:
    """Makes and caches readers of fields. `lookup`: `package/msg/Name` -> definition text with the types it uses, else
    KeyError."""

    def __init__(self, lookup: Callable[[str], str]) -> None:
        self._store = DefinitionStore(lookup)
        self._shapes: dict[str, Shapes] = {}
        self._readers: dict[tuple[str, tuple[str, ...]], FieldReader] = {}

    def reader(self, type_name: str, paths: Sequence[str]) -> FieldReader:
        """A reader of these fields; the same object for the same arguments.

        UnknownTypeError (a ValueError) when a definition is missing; ValueError with all wrong paths and what there is.
        """
        key = type_name, tuple(paths)
        if key not in self._readers:
            self._readers[key] = self._make(type_name, paths)
        return self._readers[key]

    def fields(self, type_name: str) -> Sequence[str]:
        """Every path to a single value or series of simple values, at most FIELDS_LISTED_MAX; ValueError as above."""
        shapes, name = self._open(type_name)
        return [path for path, _ in zip(_paths(shapes, name, ""), range(FIELDS_LISTED_MAX), strict=False)]

    def stamp_path(self, type_name: str) -> str:
        """The path to the time of measurement: that of the header, else of the field `stamp`; `""` without either."""
        shapes, name = self._open(type_name)
        single = {(member.name, member.type) for member in shapes.fields(name) if member.kind == SINGLE}
        if ("header", "std_msgs/Header") in single:
            return "header.stamp"
        return "stamp" if ("stamp", "builtin_interfaces/Time") in single else ""

    def _open(self, type_name: str) -> tuple[Shapes, str]:
        name = short_name(type_name)
        if name not in self._shapes:
            shapes = Shapes(self._store.scope(name))
            shapes.of_type(name)
            self._shapes[name] = shapes
        return self._shapes[name], name

    def _make(self, type_name: str, paths: Sequence[str]) -> FieldReader:
        if len(paths) > PATHS_MAX:
            raise ValueError(f"{type_name}: {len(paths)} fields; at most {PATHS_MAX} are read at once")
        shapes, name = self._open(type_name)
        want = FieldSelection()
        leaves: list[Leaf] = []
        problems: list[str] = []
        for path in paths:
            try:
                leaves.append(add_path(shapes, name, path, want, len({leaf.slot for leaf in leaves})))
            except ValueError as error:
                problems.append(str(error))
        if problems:
            raise ValueError("; ".join(problems))
        steps = [Compiler(shapes, order, {}).program(name, want) for order in "><"]
        return FieldReader(type_name, paths, leaves, steps)


def _paths(shapes: Shapes, type_name: str, prefix: str) -> Iterator[str]:
    for member in shapes.fields(type_name):
        path = prefix + member.name
        if member.type in CODES or member.type in TEXTS or (member.type in TIMES and member.kind == SINGLE):
            yield path
        else:
            yield from _paths(shapes, member.type, f"{path}{'' if member.kind == SINGLE else '[]'}.")
