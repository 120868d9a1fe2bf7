"""The bounds of MQTT packets in a stream of bytes (MQTT 5, sections 1.5.5 and 2.1)."""

from __future__ import annotations

PACKET_BYTES_MAX = 32 * 1024 * 1024  # a receiver's memory is bounded; CONNECT says so to the broker


class MalformedPacketError(Exception):
    """Bytes of the peer that are no MQTT; the connection has to be made anew."""


def packet_bounds(buffer: bytearray, place: int, size: int) -> tuple[int, int] | None:
    """Begin and end of the content of the packet at `place`; None when its `size` bytes do not hold all of it yet.
    MalformedPacketError when it would be longer than PACKET_BYTES_MAX."""
    length = read_number(buffer, place + 1, size) if place < size else None
    if length is not None and length[0] > PACKET_BYTES_MAX:
        raise MalformedPacketError(f"a packet of {length[0]} bytes")
    if length is None or length[1] + length[0] > size:
        return None
    return length[1], length[1] + length[0]


def read_number(buffer: bytes | bytearray, place: int, end: int) -> tuple[int, int] | None:
    """The variable byte integer at `place` and the position of its end; None when it goes on beyond `end`."""
    value = 0
    for shift in (0, 7, 14, 21):
        if place >= end:
            return None
        byte = buffer[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
    raise MalformedPacketError


def write_number(number: int) -> bytes:
    """A number below 2^28 as a variable byte integer."""
    parts = bytearray()
    while True:
        number, part = divmod(number, 128)
        parts.append(part | (0x80 if number else 0))
        if not number:
            return bytes(parts)
