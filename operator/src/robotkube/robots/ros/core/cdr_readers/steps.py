"""The steps of a reading program: each goes from a position in a serialised message to the next, and may read.

A step is called with the message, a position and the list of values read so far (a slot per value), and returns the
position behind its part. It raises ValueError or struct.error when the message ends too early, and never
makes anything larger than a small multiple of the message, whatever the lengths in it say.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any

from robotkube.robots.ros.core.cdr import NANOSECONDS
from robotkube.robots.ros.core.cdr_readers.sizes import Sizes, padding, stretch

Data = bytes | memoryview
Step = Callable[[Data, int, list[Any]], int]
Extent = Callable[[Data, int], tuple[int, int]]
"""A function from a position before elements to their number and the position behind that number."""

TOO_SHORT = "the message ends too early"
NATIVE = "<" if sys.byteorder == "little" else ">"
_UTF_16 = f"utf-16-{'le' if NATIVE == '<' else 'be'}"


def run(steps: Sequence[Step], data: Data, position: int, out: list[Any]) -> int:
    """Run all steps, one after the other; returns the position behind the last."""
    for step in steps:
        position = step(data, position, out)
    return position


def counted(heads: Sizes, order: str, least: int) -> Extent:
    """The extent of a sequence whose length stands `heads` further on; ValueError when the least elements do not
    fit."""
    unpack = Struct(order + "I").unpack_from

    def extent(data: Data, position: int) -> tuple[int, int]:
        position += heads[position & 7]
        (count,) = unpack(data, position)
        position += 4
        if count * least > len(data) - position:
            raise ValueError(TOO_SHORT)
        return count, position

    return extent


def fixed(heads: Sizes, count: int, least: int) -> Extent:
    """The extent of an array of `count` elements `heads` further on."""

    def extent(data: Data, position: int) -> tuple[int, int]:
        position += heads[position & 7]
        if count * least > len(data) - position:
            raise ValueError(TOO_SHORT)
        return count, position

    return extent


# skipping -------------------------------------------------------------------------------------------------------------


def skip_fixed(sizes: Sizes) -> Step:
    """A step over a value of fixed size."""
    return lambda data, position, out: position + sizes[position & 7]


def skip_text(heads: Sizes, order: str, unit: int) -> Step:
    """A step over a text of `unit` bytes per character."""
    unpack = Struct(order + "I").unpack_from

    def step(data: Data, position: int, out: list[Any]) -> int:
        position += heads[position & 7]
        return position + 4 + unit * unpack(data, position)[0]  # type: ignore[no-any-return]  # struct knows no types

    return step


def skip_elements(extent: Extent, sizes: Sizes) -> Step:
    """A step over elements of fixed size."""

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        return stretch(sizes, position, count)

    return step


def skip_each(extent: Extent, walk: Sequence[Step]) -> Step:
    """A step over elements whose size depends on the message."""

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        for _ in range(count):
            position = run(walk, data, position, out)
        return position

    return step


# reading --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ReadRun:
    """A step that reads values of fixed size at fixed distances at once. `structs`: by `position & 7`; `slots`: of the
    values."""

    structs: tuple[Struct, ...]
    slots: tuple[int, ...]

    def __call__(self, data: Data, position: int, out: list[Any]) -> int:
        """See Step."""
        layout = self.structs[position & 7]
        for slot, value in zip(self.slots, layout.unpack_from(data, position), strict=True):
            out[slot] = value
        return position + layout.size


def read_time(heads: Sizes, order: str, slot: int, parts: Sequence[int | None]) -> Step:
    """A step that reads a Time or Duration as ns; seconds and nanoseconds go into the slots of `parts` that are
    given."""
    unpack = Struct(order + "iI").unpack_from

    def step(data: Data, position: int, out: list[Any]) -> int:
        position += heads[position & 7]
        seconds, nanoseconds = values = unpack(data, position)
        out[slot] = seconds * NANOSECONDS + nanoseconds
        for part, value in zip(parts, values, strict=True):
            if part is not None:
                out[part] = value
        return position + 8

    return step


def read_text(heads: Sizes, order: str, unit: int, slot: int) -> Step:
    """A step that reads a text without its end mark."""
    unpack = Struct(order + "I").unpack_from

    def step(data: Data, position: int, out: list[Any]) -> int:
        position += heads[position & 7]
        begin = position + 4
        end: int = begin + unit * unpack(data, position)[0]
        if end > len(data):
            raise ValueError(TOO_SHORT)
        out[slot] = _text(data[begin:end]) if unit == 1 else _wide_text(data[begin:end], order)
        return end

    return step


def _text(octets: Data) -> str:
    return str(octets, "utf-8").removesuffix("\0")


def _wide_text(octets: Data, order: str) -> str:
    units = _numbers("I", octets, order)
    if units and max(units) > 0xFFFF:
        raise ValueError("a wstring holds more than UTF-16 units")
    return array("H", units).tobytes().decode(_UTF_16)


def _numbers(code: str, octets: Data, order: str) -> array[Any]:
    values: array[Any] = array(code)
    values.frombytes(octets)
    if order != NATIVE:
        values.byteswap()
    return values


def series(code: str, values: Any) -> Sequence[Any]:
    """The values as array.array for numbers, as tuple for everything else (code `?` or empty)."""
    return array(code, values) if code and code != "?" else tuple(values)


def read_numbers(extent: Extent, code: str, order: str, slots: Mapping[int | None, int]) -> Step:
    """A step that reads elements that are numbers: the whole series (key None) and single ones (their index)."""
    layout = Struct(order + code)
    size = layout.size

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        if count:
            position += padding(position, size)
        end = position + count * size
        if end > len(data):
            raise ValueError(TOO_SHORT)
        for index, slot in slots.items():
            if index is not None:
                out[slot] = layout.unpack_from(data, position + _within(index, count) * size)[0]
            elif code == "?":
                out[slot] = tuple(map(bool, data[position:end]))
            else:
                out[slot] = _numbers(code, data[position:end], order)
        return end

    return step


def _within(index: int, count: int) -> int:
    if index >= count:
        raise ValueError(f"the message has {count} elements where [{index}] is read")
    return index


def read_texts(extent: Extent, read_element: Step, slots: Mapping[int | None, int]) -> Step:
    """A step that reads elements that are texts; `read_element` reads one of them into slot 0."""

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        texts = []
        place = [""]
        for _ in range(count):
            position = read_element(data, position, place)
            texts.append(place[0])
        for index, slot in slots.items():
            out[slot] = tuple(texts) if index is None else texts[_within(index, count)]
        return position

    return step


@dataclass(frozen=True, slots=True)
class Every:
    """The reads of each element: `steps` to its end with slots of their own; `columns`: code and slot outside."""

    steps: Sequence[Step]
    columns: Sequence[tuple[str, int]]


def read_elements(extent: Extent, sizes: Sizes, picks: Mapping[int, Sequence[Step]]) -> Step:
    """A step that reads single elements of fixed size."""

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        for index, steps in picks.items():
            run(steps, data, stretch(sizes, position, _within(index, count)), out)
        return stretch(sizes, position, count)

    return step


def read_each(extent: Extent, walk: Sequence[Step], picks: Mapping[int, Sequence[Step]], every: Every | None) -> Step:
    """A step that reads elements of any size one after the other: single ones, and columns of all."""
    steps = every.steps if every else walk
    columns = every.columns if every else ()

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        column_values: list[list[Any]] = [[] for _ in columns]
        row: list[Any] = [None] * len(columns)
        for index in picks:
            _within(index, count)
        for index in range(count):
            if index in picks:
                run(picks[index], data, position, out)
            position = run(steps, data, position, row)
            for values, value in zip(column_values, row, strict=True):
                values.append(value)
        for (code, slot), values in zip(columns, column_values, strict=True):
            out[slot] = series(code, values)
        return position

    return step


def read_columns(extent: Extent, sizes: Sizes, element: ReadRun, columns: Sequence[tuple[str, int]]) -> Step:
    """A step that reads columns of elements of fixed size with one read each: from the second element on all at once.

    `columns`: code and slot of each value of `element`.
    """

    def step(data: Data, position: int, out: list[Any]) -> int:
        count, position = extent(data, position)
        end = stretch(sizes, position, count)
        if end > len(data):
            raise ValueError(TOO_SHORT)
        column_values: list[list[Any]] = [[] for _ in columns]
        while position < end:
            layout = element.structs[position & 7]
            size = sizes[position & 7]
            if size & 7 == 0:  # the next one stands in the same way, and so do all others
                rows = list(Struct(f"{layout.format}{size - layout.size}x").iter_unpack(data[position:end]))
                for place, values in enumerate(column_values):
                    values += [row[place] for row in rows]
                break
            for values, value in zip(column_values, layout.unpack_from(data, position), strict=True):
                values.append(value)
            position += size
        for (code, slot), values in zip(columns, column_values, strict=True):
            out[slot] = series(code, values)
        return end

    return step
