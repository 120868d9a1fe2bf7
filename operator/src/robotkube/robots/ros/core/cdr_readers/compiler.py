"""Compilation of the paths that are wanted of a type into the steps that read them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from struct import Struct, calcsize
from typing import cast

from robotkube.foundation.documents.core.patterns import ROS_WORD
from robotkube.robots.ros.core.cdr_readers import steps as steps_of
from robotkube.robots.ros.core.cdr_readers.sizes import CODES, TEXTS, TIMES, Shapes, Sizes, after, aligned, padding
from robotkube.robots.ros.core.cdr_readers.steps import Step
from robotkube.robots.ros.core.message_definitions import ARRAY, SEQUENCE, SINGLE, Field

NUMBER, TRUTH, TEXT, SERIES = "number", "bool", "text", "series"
"""The kinds of values: int or float; bool; str; several values (array.array of numbers, else a tuple)."""

PATH_PARTS_MAX = 64
INLINE_FIELDS_MAX = 200

_PART = re.compile(rf"(?P<name>{ROS_WORD.pattern})(?P<selector>\[\d{{0,9}}\])?")


@dataclass
class FieldSelection:
    """The selection of a value: the value itself (`slot`), fields of it, elements of it (None: of every element).

    `code`: that of the value in an array; empty when it is a text or has several elements.
    """

    slot: int | None = None
    code: str = ""
    fields: dict[str, FieldSelection] = field(default_factory=dict)
    elements: dict[int | None, FieldSelection] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Leaf:
    """The target of a path: `kind` is NUMBER, TRUTH, TEXT or SERIES; its value gets into `slot`.

    `code`: that of `struct` for a number or bool, else empty.
    """

    kind: str
    slot: int
    code: str


@dataclass(frozen=True, slots=True)
class _FixedValue:
    """A value of fixed size that is wanted."""

    code: str
    slot: int


def add_path(shapes: Shapes, type_name: str, path: str, want: FieldSelection, slot: int) -> Leaf:
    """Add a path to the selection of a type; a path that is there already keeps its slot.

    ValueError says which part is wrong and what there is.
    """
    parts = path.split(".")
    if len(parts) > PATH_PARTS_MAX:
        raise ValueError(f"{path[:80]}: more than {PATH_PARTS_MAX} parts")
    every = whole = False
    for place, part in enumerate(parts):
        last = place == len(parts) - 1
        member, selector = _member(shapes, type_name, path, part)
        want = want.fields.setdefault(member.name, FieldSelection())
        type_name = member.type
        simple = type_name in CODES or type_name in TEXTS
        if not last and simple:
            raise ValueError(f"{path}: {part} is of type {type_name} and has no fields")
        whole = last and member.kind != SINGLE and (not selector or (simple and selector == "[]"))
        if member.kind != SINGLE and not whole:
            index = _index(path, member, selector)
            every = every or index is None
            want = want.elements.setdefault(index, FieldSelection())
    if type_name not in CODES and type_name not in TEXTS and (whole or type_name not in TIMES):
        names = (f"{parts[-1]}{'[]' if whole else ''}.{member.name}" for member in shapes.fields(type_name))
        raise ValueError(f"{path}: it is of type {type_name}; name one of its fields: {', '.join(names)}")
    return _enter(want, type_name, whole, whole or every, slot)


def _member(shapes: Shapes, type_name: str, path: str, part: str) -> tuple[Field, str]:
    """The field that a part names, and its selector with the brackets."""
    match = _PART.fullmatch(part)
    members = shapes.fields(type_name)
    member = next((member for member in members if match and member.name == match["name"]), None)
    if match is None or member is None:
        names = ", ".join(member.name for member in members)
        raise ValueError(f"{path}: {type_name} has no field {part}; it has {names}")
    selector = match["selector"] or ""
    if selector and member.kind == SINGLE:
        raise ValueError(f"{path}: {member.name} of {type_name} is one value; leave {selector} away")
    return member, selector


def _index(path: str, member: Field, selector: str) -> int | None:
    if not selector:
        raise ValueError(f"{path}: {member.name} has several elements; write {member.name}[] or {member.name}[0]")
    index = int(selector[1:-1]) if selector != "[]" else None
    if member.kind == ARRAY and index is not None and index >= member.count:
        raise ValueError(f"{path}: {member.name} has {member.count} elements")
    return index


def _enter(want: FieldSelection, type_name: str, whole: bool, several: bool, slot: int) -> Leaf:
    code = "" if type_name in TEXTS else "q" if type_name in TIMES else CODES[type_name][0]
    if want.slot is None:
        want.slot = slot
        want.code = "" if whole else code
    kind = SERIES if several else TEXT if not code else TRUTH if code == "?" else NUMBER
    return Leaf(kind, want.slot, code if kind in (NUMBER, TRUTH) else "")


def _within_element(want: FieldSelection, columns: list[tuple[str, int]], several: bool = False) -> FieldSelection:
    """The same selection with slots from 0 on, for one element; `columns` gets each value's code and slot outside."""
    inner = FieldSelection(code=want.code)
    if want.slot is not None:
        inner.slot = len(columns)
        columns.append(("" if several else want.code, want.slot))
    for name, part in want.fields.items():
        inner.fields[name] = _within_element(part, columns, several)
    for index, part in want.elements.items():
        inner.elements[index] = _within_element(part, columns, several or index is None)
    return inner


def _is_one_read(every: steps_of.Every) -> bool:
    """Return whether one read gives all columns of an element."""
    first = every.steps[0]
    return isinstance(first, steps_of.ReadRun) and len(first.slots) == len(every.columns)


class Compiler:
    """Compiles the steps for one byte order (`<` or `>`). `walks` keeps the steps over whole values, type by type."""

    def __init__(self, shapes: Shapes, order: str, walks: dict[str, Sequence[Step]]) -> None:
        self._shapes = shapes
        self._order = order
        self._walks = walks
        self._steps: list[Step] = []
        self._run: list[Sizes | _FixedValue] = []
        self._inlined = 0

    def program(self, type_name: str, want: FieldSelection, to_the_end: bool = False) -> Sequence[Step]:
        """The steps over a value up to the last selected part, or to its end; to be called once per compiler."""
        self._read(Field("", type_name), want, to_the_end)
        rest = self._flush()
        if to_the_end and any(rest):
            self._steps.append(steps_of.skip_fixed(rest))
        return self._steps

    def _fields(self, type_name: str, want: FieldSelection, to_the_end: bool) -> None:
        waiting = set(want.fields)
        for member in self._shapes.fields(type_name):
            if not waiting and not to_the_end:
                return
            waiting.discard(member.name)
            if member.name in want.fields:
                self._read(member, want.fields[member.name], to_the_end or bool(waiting))
            else:
                self._skip(member)

    # skipping --------------------------------------------------------------------------------------------------------

    def _skip(self, member: Field) -> None:
        sizes = self._shapes.of_field(member).sizes
        if sizes is not None:
            self._run.append(sizes)
        elif member.kind != SINGLE:
            element = self._shapes.of_type(member.type)
            extent = self._extent(member)
            if element.sizes is not None:
                self._steps.append(steps_of.skip_elements(extent, element.sizes))
            else:
                self._steps.append(steps_of.skip_each(extent, self._walk(member.type)))
        elif member.type in TEXTS:
            self._steps.append(steps_of.skip_text(self._heads(4), self._order, TEXTS[member.type]))
        elif self._inlined < INLINE_FIELDS_MAX:
            self._inlined += 1
            self._fields(member.type, FieldSelection(), to_the_end=True)
        else:
            self._steps += [steps_of.skip_fixed(self._flush()), *self._walk(member.type)]

    def _walk(self, type_name: str) -> Sequence[Step]:
        """The steps over one value of a type whose size depends on the message."""
        if type_name not in self._walks:
            compiler = Compiler(self._shapes, self._order, self._walks)
            compiler._skip(Field("", type_name))
            rest = compiler._flush()
            self._walks[type_name] = [*compiler._steps, steps_of.skip_fixed(rest)]
        return self._walks[type_name]

    # reading ---------------------------------------------------------------------------------------------------------

    def _read(self, member: Field, want: FieldSelection, to_the_end: bool) -> None:
        if member.kind != SINGLE:
            self._read_elements(member, want)
        elif member.type in CODES and want.slot is not None:
            self._run.append(_FixedValue(CODES[member.type][0], want.slot))
        elif member.type in TEXTS and want.slot is not None:
            unit = TEXTS[member.type]
            self._steps.append(steps_of.read_text(self._heads(4), self._order, unit, want.slot))
        elif member.type in TIMES and want.slot is not None:
            parts = [want.fields[name].slot if name in want.fields else None for name in ("sec", "nanosec")]
            self._steps.append(steps_of.read_time(self._heads(4), self._order, want.slot, parts))
        else:
            self._fields(member.type, want, to_the_end)

    def _read_elements(self, member: Field, want: FieldSelection) -> None:
        extent = self._extent(member)
        slots = {index: part.slot for index, part in want.elements.items() if part.slot is not None}
        whole = slots if want.slot is None else {None: want.slot, **slots}
        if member.type in CODES:
            self._steps.append(steps_of.read_numbers(extent, CODES[member.type][0], self._order, whole))
        elif member.type in TEXTS:
            read_element = steps_of.read_text(aligned(4), self._order, TEXTS[member.type], 0)
            self._steps.append(steps_of.read_texts(extent, read_element, whole))
        else:
            self._read_structures(member.type, want, extent)

    def _read_structures(self, type_name: str, want: FieldSelection, extent: steps_of.Extent) -> None:
        sizes = self._shapes.of_type(type_name).sizes
        picks = {i: self._part(type_name, part) for i, part in want.elements.items() if i is not None}
        every = self._every(type_name, want.elements[None]) if None in want.elements else None
        if every is None and sizes is not None:
            self._steps.append(steps_of.read_elements(extent, sizes, picks))
        elif every is not None and sizes is not None and not picks and _is_one_read(every):
            run = cast(steps_of.ReadRun, every.steps[0])
            columns = [every.columns[slot] for slot in run.slots]
            self._steps.append(steps_of.read_columns(extent, sizes, run, columns))
        else:
            walk = [steps_of.skip_fixed(sizes)] if sizes is not None else self._walk(type_name)
            self._steps.append(steps_of.read_each(extent, walk, picks, every))

    def _every(self, type_name: str, want: FieldSelection) -> steps_of.Every:
        columns: list[tuple[str, int]] = []
        inner = _within_element(want, columns)
        return steps_of.Every(self._part(type_name, inner, to_the_end=True), columns)

    def _part(self, type_name: str, want: FieldSelection, to_the_end: bool = False) -> Sequence[Step]:
        return Compiler(self._shapes, self._order, self._walks).program(type_name, want, to_the_end)

    # runs of values of fixed size ------------------------------------------------------------------------------------

    def _extent(self, member: Field) -> steps_of.Extent:
        least = self._shapes.of_type(member.type).least
        if member.kind == SEQUENCE:
            return steps_of.counted(self._heads(4), self._order, least)
        return steps_of.fixed(self._flush(), member.count, least)

    def _heads(self, size: int) -> Sizes:
        """Bytes to skip up to the next value of `size` bytes."""
        return after([self._flush(), aligned(size)])

    def _flush(self) -> Sizes:
        """Add the read of the values that are waiting; returns the bytes to skip behind the last of them."""
        last = max((place for place, item in enumerate(self._run) if isinstance(item, _FixedValue)), default=-1)
        pending = self._run[: last + 1]
        rest = self._run[last + 1 :]
        self._run = []
        if pending:
            slots = tuple(item.slot for item in pending if isinstance(item, _FixedValue))
            structs = tuple(Struct(self._format(pending, position)) for position in range(8))
            self._steps.append(steps_of.ReadRun(structs, slots))
        return after(item for item in rest if not isinstance(item, _FixedValue))

    def _format(self, items: Sequence[Sizes | _FixedValue], position: int) -> str:
        parts = [self._order]
        skipped = 0
        for item in items:
            if isinstance(item, _FixedValue):
                size = calcsize(item.code)
                skipped += padding(position + skipped, size)
                parts.append(f"{skipped}x{item.code}")
                position = position + skipped + size
                skipped = 0
            else:
                skipped += item[(position + skipped) & 7]
        return "".join(parts)
