"""Random message types with their definition texts, random values of them, and how they are serialised."""

from __future__ import annotations

import random
import struct
from array import array
from dataclasses import dataclass
from typing import Any

from robotkube.robots.ros.core.cdr import BIG_ENDIAN, LITTLE_ENDIAN, NANOSECONDS, CdrWriter

TIME = "builtin_interfaces/Time"
NUMBERS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
TEXTS = ("string", "wstring")


@dataclass
class Member:
    name: str
    type: str
    extent: str = ""
    count: int = 0
    bound: str = ""


class RandomTypes:
    """A top type `test_msgs/T0` and up to four that it uses."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)  # noqa: S311 - the same cases every time
        self.types: dict[str, list[Member]] = {TIME: [Member("sec", "int32"), Member("nanosec", "uint32")]}
        for number in range(self.draw.randrange(1, 5), -1, -1):
            others = [name for name in self.types if name != f"test_msgs/T{number}"]
            self.types[f"test_msgs/T{number}"] = [
                self._member(f"m{n}", others) for n in range(self.draw.randrange(0 if number else 1, 7))
            ]
        self.top = "test_msgs/T0"

    def _member(self, name: str, others: list[str]) -> Member:
        kind = self.draw.choices(["number", "text", "other"], [6, 2, 2])[0]
        one = {"number": list(NUMBERS), "text": list(TEXTS), "other": others}[kind]
        member = Member(name, self.draw.choice(one))
        member.extent = self.draw.choices(["", "array", "sequence"], [4, 1, 2])[0]
        member.count = self.draw.randrange(1, 12)
        member.bound = self.draw.choice(["", "<=12"]) if kind == "text" else ""
        return member

    # the definition ---------------------------------------------------------------------------------------------------

    def text(self) -> str:
        """The definition as packages have it, with comments, constants and default values."""
        others = [name for name in self.types if name != self.top]
        self.draw.shuffle(others)
        parts = [f"{'=' * 80}\nMSG: {name}\n{self._lines(name)}" for name in others]
        return "\n".join([self._lines(self.top), *parts])

    def _lines(self, type_name: str) -> str:
        lines = ["# a comment", "", "uint8 LIMIT=12   # a constant", 'string NAME = "a # b"']
        for member in self.types[type_name]:
            extent = {"": "", "array": f"[{member.count}]", "sequence": self.draw.choice(["[]", "[<=20]"])}
            used = member.type if self.draw.random() < 0.5 else member.type.removeprefix("test_msgs/")
            default = " 1" if not member.extent and member.type in NUMBERS and self.draw.random() < 0.3 else ""
            lines.append(f"{used}{member.bound}{extent[member.extent]}  {member.name}{default}  # what it is")
        return self.draw.choice(["\n", "\r\n"]).join(lines)

    # values -----------------------------------------------------------------------------------------------------------

    def value(self, member: Member) -> Any:
        """A value of a member: a number, a text, a dict of members, or a list of these."""
        if not member.extent:
            return self.one(member.type)
        count = member.count if member.extent == "array" else self.draw.choice([0, 0, 1, 3, 9, 19])
        return [self.one(member.type) for _ in range(count)]

    def one(self, type_name: str) -> Any:
        if type_name in TEXTS:
            return self.draw.choice(["", "a", "map", "größe", "日本", "🤖x", "x" * 12])
        if type_name in NUMBERS:
            code = NUMBERS[type_name]
            size = struct.calcsize(code)
            if code in "fd":
                return struct.unpack(code, struct.pack(code, self.draw.uniform(-1e6, 1e6)))[0]
            return struct.unpack(code, self.draw.randbytes(size) if code != "?" else self.draw.choice([b"\0", b"\1"]))[
                0
            ]
        return {member.name: self.value(member) for member in self.types[type_name]}

    def message(self, value: dict[str, Any], little: bool) -> bytes:
        """The value of the top type, serialised."""
        writer = CdrWriter(bytearray(LITTLE_ENDIAN if little else BIG_ENDIAN))
        self._write(writer, self.top, value)
        return bytes(writer.data)

    def _write(self, writer: CdrWriter, type_name: str, value: Any) -> None:
        if type_name == "string":
            writer.text(value)
        elif type_name == "wstring":
            units = array("H", value.encode("utf-16-le"))
            for number in (len(units), *units):
                writer.number("I", number)
        elif type_name in NUMBERS:
            writer.number(NUMBERS[type_name], value)
        else:
            if not self.types[type_name]:
                writer.number("B", 0)
            for member in self.types[type_name]:
                self._write_member(writer, member, value[member.name])

    def _write_member(self, writer: CdrWriter, member: Member, value: Any) -> None:
        if member.extent == "sequence":
            writer.number("I", len(value))
        for one in value if member.extent else [value]:
            self._write(writer, member.type, one)

    # paths ------------------------------------------------------------------------------------------------------------

    def path(self, value: dict[str, Any]) -> tuple[str, Any] | None:
        """A random path into a value of the top type and what stands there; None when it led to nothing."""
        return self._path(self.top, [value], one=True)

    def _path(self, type_name: str, values: list[Any], one: bool) -> tuple[str, Any] | None:
        """`values`: what is at this place, one for each element that the path's `[]` stand for (nested lists)."""
        if not self.types[type_name]:
            return None
        member = self.draw.choice(self.types[type_name])
        path = member.name
        reached = [value[member.name] for value in values]
        simple = member.type in NUMBERS or member.type in TEXTS
        if member.extent:
            if simple and self.draw.random() < 0.5:
                return path + self.draw.choice(["", "[]"]), reached[0] if one else reached
            shortest = min((len(elements) for elements in reached), default=0)
            if shortest and self.draw.random() < 0.6:
                index = self.draw.randrange(shortest)
                path, reached = f"{path}[{index}]", [elements[index] for elements in reached]
            elif one and not simple:
                path = f"{path}[]"
                reached = reached[0]
                one = False
            else:
                return None
        if simple:
            return path, reached[0] if one else reached
        if member.type == TIME and self.draw.random() < 0.5:
            times = [value["sec"] * NANOSECONDS + value["nanosec"] for value in reached]
            return path, times[0] if one else times
        rest = self._path(member.type, reached, one)
        return (f"{path}.{rest[0]}", rest[1]) if rest else None


def plain(value: Any) -> Any:
    """Series of any kind as lists."""
    return [plain(one) for one in value] if isinstance(value, (array, tuple, list)) else value
