"""The wire format of ika's mqtt_client for ROS 2 (github.com/ika-rwth-aachen/mqtt_client, version 2).

A message is the serialised ROS message, behind a serialised builtin_interfaces/Time when the sender injects stamps.
What type it is, and whether it is stamped, stands in a retained mqtt_client_interfaces/RosMsgType of a topic beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

from robotkube.domain.cdr import ENCAPSULATION, CdrReader, CdrWriter
from robotkube.domain.frames import FrameError

TYPE_PREFIX = "mqtt_client/ros_msg_type/"
STAMP_BYTES = 12  # encapsulation, seconds, nanoseconds
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class RosMessageType:
    """mqtt_client_interfaces/RosMsgType; `md5` and `definition` stay empty for ROS 2."""

    name: str
    stamped: bool


def type_topic(topic: str) -> str:
    """Where the type of the messages of an MQTT topic stands."""
    return TYPE_PREFIX + topic


def encode_type(kind: RosMessageType) -> bytes:
    """The type's message."""
    writer = CdrWriter()
    for text in ("", kind.name, ""):
        writer.text(text)
    writer.number("?", kind.stamped)
    return bytes(writer.data)


def decode_type(data: bytes) -> RosMessageType:
    """The type in `data`; FrameError when that is no RosMsgType."""
    try:
        reader = CdrReader(data)
        _, name, _ = reader.text(), reader.text(), reader.text()
        return RosMessageType(name, bool(reader.number("B")))
    except ValueError as error:
        raise FrameError(f"{len(data)} bytes are no RosMsgType of mqtt_client: {error}") from error


def encode_message(data: bytes, stamp: int | None) -> bytes:
    """A payload from a serialised message; `stamp` in ns since 1970 is put before it."""
    if stamp is None:
        return data
    writer = CdrWriter()
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    writer.number("i", seconds)
    writer.number("I", nanoseconds)
    return bytes(writer.data) + data


def decode_message(payload: bytes, stamped: bool) -> tuple[bytes, int | None]:
    """The serialised message and the injected stamp; FrameError when the payload is too short or no CDR."""
    stamp, begin = None, 0
    if stamped:
        if len(payload) < STAMP_BYTES:
            raise FrameError(f"a payload of {len(payload)} bytes is shorter than its stamp")
        reader = CdrReader(payload[:STAMP_BYTES])
        stamp, begin = int(reader.number("i")) * NANOSECONDS + int(reader.number("I")), STAMP_BYTES
    if len(payload) - begin < ENCAPSULATION or payload[begin] != 0 or payload[begin + 1] > 1:
        raise FrameError(f"a payload of {len(payload)} bytes holds no serialised message at byte {begin}")
    return payload[begin:], stamp
