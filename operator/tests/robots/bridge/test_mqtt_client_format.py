"""ika's mqtt_client: every byte as its sources say, written down by hand, and against ROS's own serialisation."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.bridge.core import mqtt_client_format as ika
from robotkube.robots.mqtt.core.batches import BatchError

# Serialised as rclcpp does: encapsulation (little endian CDR), then values at multiples of their size.
# RosMsgType: string md5, string name, string definition, bool stamped. A string: length with its NUL, text, NUL.
TYPE = bytes.fromhex(
    "00010000"  # encapsulation
    "01000000 00"  # md5: empty
    "000000"  # up to a multiple of four
    "14000000 7374645f6d7367732f6d73672f537472696e67 00"  # name: std_msgs/msg/String
    "01000000 00"  # definition: empty
    "00"  # stamped: false
)
STAMPED_TYPE = TYPE[:-1] + b"\x01"
# std_msgs/msg/String "hi"
MESSAGE = bytes.fromhex("00010000 03000000 686900")
# builtin_interfaces/msg/Time: int32 sec, uint32 nanosec; 1795250000 s and 5 ns
STAMP = bytes.fromhex("00010000 5057016b 05000000")
STAMP_NS = 1_795_250_000 * 10**9 + 5


def test_types_are_written_and_read_byte_for_byte() -> None:
    for data, stamped in ((TYPE, False), (STAMPED_TYPE, True)):
        kind = ika.RosMessageType("std_msgs/msg/String", stamped)
        assert ika.encode_type(kind) == data
        assert ika.decode_type(data) == kind
    assert ika.type_topic("ping/ros") == "mqtt_client/ros_msg_type/ping/ros"


def test_messages_are_written_and_read_byte_for_byte() -> None:
    assert ika.encode_message(MESSAGE, None) == MESSAGE
    assert ika.encode_message(MESSAGE, STAMP_NS) == STAMP + MESSAGE
    assert ika.decode_message(MESSAGE, stamped=False) == (MESSAGE, None)
    assert ika.decode_message(STAMP + MESSAGE, stamped=True) == (MESSAGE, STAMP_NS)
    assert len(STAMP) == ika.STAMP_BYTES


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of a parser that rclpy imports
def test_the_bytes_are_those_of_ros() -> None:
    """What rclcpp writes is what rclpy writes: both ask the same type support."""
    from builtin_interfaces.msg import Time
    from rclpy.serialization import serialize_message
    from std_msgs.msg import String

    serialised: Any = serialize_message
    seconds, nanoseconds = divmod(STAMP_NS, 10**9)
    assert serialised(Time(sec=seconds, nanosec=nanoseconds)) == STAMP
    assert serialised(String(data="hi")) == MESSAGE


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", TYPE[:-1], TYPE[:20], b"\0\1\0\0\xff\xff\xff\xff"])
def test_what_is_no_type_is_refused(data: bytes) -> None:
    with pytest.raises(BatchError, match=f"{len(data)} bytes are no RosMsgType"):
        ika.decode_type(data)


@pytest.mark.parametrize(("data", "stamped"), [(b"", False), (b"text", False), (STAMP, True), (STAMP[:11], True)])
def test_what_is_no_message_is_refused(data: bytes, stamped: bool) -> None:
    with pytest.raises(BatchError, match=f"a payload of {len(data)} bytes"):
        ika.decode_message(data, stamped)


@given(st.binary(max_size=80))
def test_anything_is_a_message_a_type_or_an_error(data: bytes) -> None:
    with suppress(BatchError):
        assert isinstance(ika.decode_type(data).name, str)
    for stamped in (True, False):
        with suppress(BatchError):
            assert data.endswith(ika.decode_message(data, stamped)[0])
