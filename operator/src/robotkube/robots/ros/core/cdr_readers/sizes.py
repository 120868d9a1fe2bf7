"""The sizes of fields of message types, padding included, from any position in a serialised message.

Only a position's alignment matters, so a fixed size is a table of eight: for `position & 7`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from robotkube.robots.ros.core.cdr import ENCAPSULATION
from robotkube.robots.ros.core.message_definitions import (
    ARRAY,
    SEQUENCE,
    Definitions,
    Field,
    read_definitions,
    short_name,
)

NESTING_MAX = 32
SIZE_MAX = 1 << 40

CODES: Mapping[str, tuple[str, int]] = MappingProxyType(
    {
        "bool": ("?", 1),
        "byte": ("B", 1),
        "char": ("B", 1),
        "int8": ("b", 1),
        "uint8": ("B", 1),
        "int16": ("h", 2),
        "uint16": ("H", 2),
        "int32": ("i", 4),
        "uint32": ("I", 4),
        "int64": ("q", 8),
        "uint64": ("Q", 8),
        "float32": ("f", 4),
        "float64": ("d", 8),
    }
)
"""Numbers: the code of `struct` and `array` (char is a byte in ROS 2), and the bytes it takes."""

TEXTS: Mapping[str, int] = MappingProxyType({"string": 1, "wstring": 4})
"""Texts: bytes per unit."""

TIMES = frozenset(["builtin_interfaces/Time", "builtin_interfaces/Duration"])

Sizes = tuple[int, ...]
"""Bytes from a position to the end of a value, by `position & 7`."""


class UnknownTypeError(ValueError):
    """The definition of a type is not known."""


@dataclass(frozen=True, slots=True)
class Shape:
    """The size of a type or field: `sizes` is None when it depends on the message; it is never less than `least`."""

    sizes: Sizes | None
    least: int


def padding(position: int, size: int) -> int:
    """Bytes from `position` to the next place for a value of `size` bytes."""
    return (ENCAPSULATION - position) % size


def after(sizes: Iterable[Sizes]) -> Sizes:
    """The sizes of several values that stand one behind the other."""
    ends = list(range(8))
    for table in sizes:
        ends = [end + table[end & 7] for end in ends]
    return tuple(end - position for position, end in enumerate(ends))


def aligned(size: int) -> Sizes:
    """The padding before a value of `size` bytes."""
    return tuple(padding(position, size) for position in range(8))


def stretch(sizes: Sizes, position: int, count: int) -> int:
    """The end of `count` equal values from `position`: from the second on, eight of them repeat the alignment."""
    if count:
        position += sizes[position & 7]
        count -= 1
    if count >= 8:
        end = position
        for _ in range(8):
            end += sizes[end & 7]
        position += (end - position) * (count // 8)
    for _ in range(count % 8):
        position += sizes[position & 7]
    return position


class Shapes:
    """Shapes of types and fields; `find` gives the fields of `package/Name` or raises UnknownTypeError."""

    def __init__(self, find: Callable[[str], tuple[Field, ...]]) -> None:
        self.fields = find
        self._known: dict[str, Shape] = {}
        self._open: list[str] = []

    def of_type(self, name: str) -> Shape:
        """The shape of one value; ValueError when the type contains itself, nests too deeply or is too large."""
        if name in CODES:
            size = CODES[name][1]
            return Shape(tuple(padding(position, size) + size for position in range(8)), size)
        if name in TEXTS:
            return Shape(None, 4)
        if name not in self._known:
            self._known[name] = self._of_struct(name)
        return self._known[name]

    def of_field(self, field: Field) -> Shape:
        """The shape of a field."""
        if field.kind == SEQUENCE:
            self.of_type(field.type)
            return Shape(None, 4)
        shape = self.of_type(field.type)
        return _repeated(shape, field.count) if field.kind == ARRAY else shape

    def _of_struct(self, name: str) -> Shape:
        if name in self._open:
            raise ValueError(f"{name} contains itself")
        if len(self._open) >= NESTING_MAX:
            raise ValueError(f"{name} is the {NESTING_MAX + 1}th type within another; at most {NESTING_MAX} are read")
        self._open.append(name)
        try:
            shapes = [self.of_field(field) for field in self.fields(name)]
        finally:
            self._open.pop()
        tables = [shape.sizes for shape in shapes if shape.sizes is not None]
        least = sum(shape.least for shape in shapes)
        if least > SIZE_MAX:
            raise ValueError(f"{name} takes more than {SIZE_MAX} bytes")
        return Shape(after(tables) if len(tables) == len(shapes) else None, least)


def _repeated(shape: Shape, count: int) -> Shape:
    least = shape.least * count
    if shape.sizes is None:
        return Shape(None, least)
    sizes = shape.sizes
    return Shape(tuple(stretch(sizes, position, count) - position for position in range(8)), least)


class DefinitionStore:
    """The fields of types by `lookup`: `package/msg/Name` -> text with its dependencies, KeyError when it is
    unknown."""

    def __init__(self, lookup: Callable[[str], str]) -> None:
        self._lookup = lookup
        self._read: dict[str, Definitions] = {}

    def scope(self, type_name: str) -> Callable[[str], tuple[Field, ...]]:
        """A function that gives the fields of a type and of everything in it; a definition's own dependencies come
        first."""
        known = dict(self._definitions(type_name))

        def find(name: str) -> tuple[Field, ...]:
            if name not in known:
                for other, fields in self._definitions(name).items():
                    known.setdefault(other, fields)
            return known[name]

        return find

    def _definitions(self, name: str) -> Definitions:
        short = short_name(name)
        if short not in self._read:
            package, _, rest = short.partition("/")
            try:
                text = self._lookup(f"{package}/msg/{rest}")
            except KeyError:
                raise UnknownTypeError(f"nobody has the definition of {package}/msg/{rest}") from None
            self._read[short] = read_definitions(short, text)
        return self._read[short]
