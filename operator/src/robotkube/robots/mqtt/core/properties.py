"""The properties of an MQTT 5 PUBLISH (MQTT 5, section 3.3.2.3), as far as messages of robots need them.

Written: content type, user properties and message expiry. Read: the first two; all others are stepped over.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from robotkube.errors import InputError
from robotkube.robots.mqtt.core.packets import MalformedPacketError, read_number

MESSAGE_EXPIRY, CONTENT_TYPE, USER_PROPERTY = 0x02, 0x03, 0x26
TEXT_BYTES_MAX = 65_535
PROPERTIES_MAX = 64

_LENGTH = struct.Struct("!H")
_FIXED_BYTES = {0x01: 1, MESSAGE_EXPIRY: 4, 0x23: 2}  # payload format, message expiry, topic alias
_EXPIRY = struct.Struct("!BI")
_LENGTH_PREFIXED = frozenset([0x08, 0x09])  # response topic, correlation data
_SUBSCRIPTION = 0x0B


class PropertiesError(InputError):
    """Bytes that are no properties of a PUBLISH."""


@dataclass(frozen=True)
class MessageProperties:
    """The content type and user properties of a message; of a user property that stands twice, the last one."""

    content_type: str = ""
    user: Mapping[str, str] = field(default_factory=dict)


def content_type(text: str) -> bytes:
    """The bytes of the property content type."""
    return bytes((CONTENT_TYPE,)) + _text(text)


def user_property(key: str, value: str) -> bytes:
    """The bytes of a user property."""
    return bytes((USER_PROPERTY,)) + _text(key) + _text(value)


def message_expiry(seconds: float) -> bytes:
    """The bytes of the property message expiry interval: whole seconds, rounded up."""
    return _EXPIRY.pack(MESSAGE_EXPIRY, math.ceil(seconds))


def read_properties(data: bytes) -> MessageProperties:
    """Read properties without their leading length; PropertiesError when they are none, or more than PROPERTIES_MAX."""
    kind = ""
    place = 0
    user: dict[str, str] = {}
    try:
        for _ in range(PROPERTIES_MAX):
            if place >= len(data):
                return MessageProperties(kind, user)
            code = data[place]
            place += 1
            if code == USER_PROPERTY:
                key, place = _read_text(data, place)
                user[key], place = _read_text(data, place)
            elif code == CONTENT_TYPE:
                kind, place = _read_text(data, place)
            else:
                place = _after(code, data, place)
    except (struct.error, UnicodeDecodeError, MalformedPacketError) as error:
        raise PropertiesError(f"{len(data)} bytes are no properties of a message: {error}") from error
    raise PropertiesError(f"more than {PROPERTIES_MAX} properties of one message")


def _text(text: str) -> bytes:
    encoded = text.encode()[:TEXT_BYTES_MAX]
    return _LENGTH.pack(len(encoded)) + encoded


def _octets(data: bytes, place: int) -> tuple[bytes, int]:
    begin = place + _LENGTH.size
    end = begin + _LENGTH.unpack_from(data, place)[0]
    if end > len(data):
        raise MalformedPacketError(f"a text ends at byte {end}")
    return data[begin:end], end


def _read_text(data: bytes, place: int) -> tuple[str, int]:
    octets, end = _octets(data, place)
    return octets.decode(), end


def _after(code: int, data: bytes, place: int) -> int:
    """The position after a property that is not read."""
    if code in _FIXED_BYTES:
        return place + _FIXED_BYTES[code]
    if code in _LENGTH_PREFIXED:
        return _octets(data, place)[1]
    if code == _SUBSCRIPTION and (number := read_number(data, place, len(data))) is not None:
        return number[1]
    raise MalformedPacketError(f"property {code:#x} at byte {place - 1}")
