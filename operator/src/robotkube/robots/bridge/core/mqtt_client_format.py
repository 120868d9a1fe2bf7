"""The wire format of ika's mqtt_client for ROS 2 (github.com/ika-rwth-aachen/mqtt_client, version 2).

A message is the serialised ROS message, behind a serialised builtin_interfaces/Time when the sender injects stamps.
What type it is, and whether it is stamped, stands in a retained mqtt_client_interfaces/RosMsgType of a topic beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

from robotkube.robots.mqtt.core.batches import BatchError
from robotkube.robots.ros.core.cdr import ENCAPSULATION, CdrReader, CdrWriter

TYPE_PREFIX = "mqtt_client/ros_msg_type/"
STAMP_BYTES = 12  # encapsulation, seconds, nanoseconds
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class RosMessageType:
    """mqtt_client_interfaces/RosMsgType; `md5` and `definition` stay empty for ROS 2."""

    name: str
    stamped: bool


def type_topic(topic: str) -> str:
    """The MQTT topic on which the type of another topic's messages stands."""
    return TYPE_PREFIX + topic


def encode_type(kind: RosMessageType) -> bytes:
    """The serialised message that states a type."""
    writer = CdrWriter()
    for text in ("", kind.name, ""):
        writer.text(text)
    writer.number("?", kind.stamped)
    return bytes(writer.data)


def decode_type(data: bytes) -> RosMessageType:
    """The type that `data` states; BatchError when that is no RosMsgType."""
    try:
        reader = CdrReader(data)
        reader.text()  # md5
        name = reader.text()
        reader.text()  # definition
        return RosMessageType(name, bool(reader.number("B")))
    except ValueError as error:
        raise BatchError(f"{len(data)} bytes are no RosMsgType of mqtt_client: {error}") from error


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
    """The serialised message and the injected stamp; BatchError when the payload is too short or no CDR."""
    stamp = None
    begin = 0
    if stamped:
        if len(payload) < STAMP_BYTES:
            raise BatchError(f"a payload of {len(payload)} bytes is shorter than its stamp")
        reader = CdrReader(payload[:STAMP_BYTES])
        stamp = int(reader.number("i")) * NANOSECONDS + int(reader.number("I"))
        begin = STAMP_BYTES
    if len(payload) - begin < ENCAPSULATION or payload[begin] != 0 or payload[begin + 1] > 1:
        raise BatchError(f"a payload of {len(payload)} bytes holds no serialised message at byte {begin}")
    return payload[begin:], stamp
