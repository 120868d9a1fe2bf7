"""Properties of MQTT 5 messages, byte for byte, and what bridges say by them."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.mqtt.core.batches import BatchError
from robotkube.robots.mqtt.core.message_properties import (
    gap_text,
    gaps_property,
    read_gap_text,
    read_gaps,
    stamp_property,
    type_properties,
    types_topic,
)
from robotkube.robots.mqtt.core.properties import (
    PROPERTIES_MAX,
    MessageProperties,
    PropertiesError,
    content_type,
    read_properties,
    user_property,
)
from robotkube.robots.ros.core.gaps import Gap

GAP = Gap("/vehicles/vehicle_00/cloud", "mqtt-bridge of vehicle-00", "waited too long for the broker", 180, 5, 17)


def test_properties_are_those_of_the_specification() -> None:
    data = content_type("a/b") + user_property("k", "v")
    assert data == b"\x03\x00\x03a/b" + b"\x26\x00\x01k\x00\x01v"
    assert read_properties(data) == MessageProperties("a/b", {"k": "v"})
    others = b"\x01\x01" + b"\x02\0\0\0\x05" + b"\x23\0\x07" + b"\x08\0\x01t" + b"\x09\0\x02\xff\xfe" + b"\x0b\x80\x01"
    assert read_properties(others + data) == MessageProperties("a/b", {"k": "v"})


@pytest.mark.parametrize(
    "data", [b"\x26", b"\x26\0\x05k", b"\x03\0\x01\xff", b"\x7f", b"\x0b\x80", b"\x26\0\x01k\0\x09v"]
)
def test_what_is_cut_off_or_unknown_is_refused(data: bytes) -> None:
    with pytest.raises(PropertiesError):
        read_properties(data)


def test_there_are_not_any_number_of_them() -> None:
    with pytest.raises(PropertiesError, match=f"more than {PROPERTIES_MAX}"):
        read_properties(user_property("k", "v") * (PROPERTIES_MAX + 1))


@given(st.dictionaries(st.text(max_size=9), st.text(max_size=30), max_size=9), st.text(max_size=30))
def test_what_is_written_is_read(user: dict[str, str], kind: str) -> None:
    data = content_type(kind) + b"".join(user_property(key, value) for key, value in user.items())
    assert read_properties(data) == MessageProperties(kind, user)


@given(st.binary(max_size=60))
def test_any_bytes_are_properties_or_an_error(data: bytes) -> None:
    with suppress(PropertiesError):
        assert isinstance(read_properties(data), MessageProperties)


def test_a_message_says_type_stamp_trace_and_what_is_missing_before_it() -> None:
    data = type_properties("geometry_msgs/msg/PoseStamped", "ab" * 16) + stamp_property(7) + gaps_property([GAP, GAP])
    properties = read_properties(data)
    assert properties.content_type == "application/x-robotkube-frames"
    assert dict(properties.user) == {
        "type": "geometry_msgs/msg/PoseStamped",
        "trace": "ab" * 16,
        "stamp": "7",
        "gaps": f"[{gap_text(GAP)}, {gap_text(GAP)}]",
    }
    assert read_gaps(properties.user["gaps"]) == [GAP, GAP]
    assert read_gap_text(gap_text(GAP)) == GAP
    assert types_topic("mqtt/v/pose") == "robotkube/types/mqtt/v/pose"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "{}",
        gap_text(GAP).replace("180", "null"),
        gap_text(GAP).replace("180", "-1"),
        gap_text(GAP).replace("180", "1e400"),
        gap_text(GAP).replace("180", "9" * 40),
        gap_text(GAP).replace('"mqtt-bridge of vehicle-00"', "[1]"),
        " " * 5000,
        "[" * 1999,
    ],
)
def test_what_is_no_gap_is_refused(text: str) -> None:
    with pytest.raises(BatchError, match="is no gap: "):
        read_gap_text(text)
    if text != "[]":
        with pytest.raises(BatchError, match="holds no gaps"):
            read_gaps(text)
