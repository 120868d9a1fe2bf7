"""Serialised messages (CDR with its encapsulation) read and written value by value, in the order of a type's fields.

A value stands at a multiple of its size, counted from the end of the encapsulation. Codes are those of `struct`:
b B h H i I q Q f d and ? for one byte, two, four or eight.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

ENCAPSULATION = 4
LITTLE_ENDIAN, BIG_ENDIAN = b"\x00\x01\x00\x00", b"\x00\x00\x00\x00"
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Header:
    """std_msgs/Header: `stamp` in ns since 1970."""

    stamp: int
    frame: str


class CdrReader:
    """Reads from the beginning of a message; ValueError when it ends too early or holds no UTF-8."""

    def __init__(self, data: bytes) -> None:
        if len(data) < ENCAPSULATION:
            raise ValueError(f"{len(data)} bytes hold no encapsulation")
        self._data = data
        self._position = ENCAPSULATION
        self.order = "<" if data[1] & 1 else ">"

    def number(self, code: str) -> int | float:
        """The next number."""
        size = struct.calcsize(code)
        start = _aligned(self._position, size)
        try:
            (value,) = struct.unpack_from(self.order + code, self._data, start)
        except struct.error as error:
            raise ValueError(f"a message of {len(self._data)} bytes ends too early") from error
        self._position = start + size
        return value  # type: ignore[no-any-return]  # what struct gives for one number

    def count(self) -> int:
        """The length of the sequence that follows."""
        return int(self.number("I"))

    def octets(self, count: int) -> memoryview:
        """The next `count` bytes as they are."""
        end = self._position + count
        if end > len(self._data):
            raise ValueError(f"a message of {len(self._data)} bytes ends too early")
        octets = memoryview(self._data)[self._position : end]
        self._position = end
        return octets

    def text(self) -> str:
        """The next text."""
        return bytes(self.octets(self.count())).rstrip(b"\0").decode()

    def header(self) -> Header:
        """The std_msgs/Header that follows."""
        seconds, nanoseconds = int(self.number("i")), int(self.number("I"))
        return Header(seconds * NANOSECONDS + nanoseconds, self.text())


@dataclass
class CdrWriter:
    """Writes a message, little endian unless `data` begins as BIG_ENDIAN; `data` is what was written so far."""

    data: bytearray = field(default_factory=lambda: bytearray(LITTLE_ENDIAN))

    @property
    def order(self) -> str:
        """The byte order as a code of `struct`."""
        return "<" if self.data[1] & 1 else ">"

    def number(self, code: str, value: int | float) -> None:
        """Append a number."""
        size = struct.calcsize(code)
        self.data += bytes(_aligned(len(self.data), size) - len(self.data))
        self.data += struct.pack(self.order + code, value)

    def text(self, value: str) -> None:
        """Append a text."""
        encoded = value.encode() + b"\0"
        self.number("I", len(encoded))
        self.data += encoded

    def header(self, header: Header) -> None:
        """Append a std_msgs/Header."""
        seconds, nanoseconds = divmod(header.stamp, NANOSECONDS)
        self.number("i", seconds)
        self.number("I", nanoseconds)
        self.text(header.frame)


def _aligned(position: int, size: int) -> int:
    """The next position at which a value of `size` bytes may stand."""
    return position + (ENCAPSULATION - position) % size
