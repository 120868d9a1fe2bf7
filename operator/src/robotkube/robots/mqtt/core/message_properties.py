"""The properties of a bridge's MQTT messages: type, stamp and trace of their content, and the gaps before them.

content type  application/x-robotkube-frames
type          geometry_msgs/msg/PoseStamped
stamp         1795250000010000000            of the first message in it, ns since 1970
trace         32 hexadecimal digits
gaps          [{"topic": ..., "where": ..., "why": ..., "count": ..., "first": ..., "last": ...}]
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.robots.mqtt.core.batches import CONTENT_TYPE, BatchError
from robotkube.robots.mqtt.core.properties import content_type, user_property
from robotkube.robots.ros.core.gaps import Gap, read_gap

MQTT_PREFIX = "mqtt"
GAPS_TOPIC = "/robotkube/gaps"
GAPS_TYPE = "std_msgs/msg/String"
GAPS_DEPTH = 1000
TYPE, STAMP, TRACE, GAPS = "type", "stamp", "trace", "gaps"
TYPES_PREFIX = "robotkube/types/"
GAP_CHARACTERS_MAX = 4000
GAPS_PER_MESSAGE_MAX = 4

_WRONG = (ValueError, KeyError, TypeError)


def types_topic(topic: str) -> str:
    """The topic that retains the definition of the type of an MQTT topic's messages: text as in MCAP's `ros2msg`."""
    return TYPES_PREFIX + topic


def type_properties(type_name: str, trace: str, encoding: str = CONTENT_TYPE) -> bytes:
    """The properties that all messages of a topic share."""
    traced = user_property(TRACE, trace) if trace else b""
    return (content_type(encoding) if encoding else b"") + user_property(TYPE, type_name) + traced


def stamp_property(stamp: int) -> bytes:
    """The property with the stamp of a message, or of the first one in a batch."""
    return user_property(STAMP, str(stamp))


def gaps_property(gaps: Sequence[Gap]) -> bytes:
    """The property with the gaps before this message, at most GAPS_PER_MESSAGE_MAX; empty without any."""
    documents = ", ".join(gap_text(gap) for gap in gaps[:GAPS_PER_MESSAGE_MAX])
    return user_property(GAPS, f"[{documents}]") if gaps else b""


def gap_text(gap: Gap) -> str:
    """A gap as a line of JSON."""
    return json.dumps({"topic": gap.topic, **gap.document()})


def read_gap_text(text: str) -> Gap:
    """The gap in a line of JSON; BatchError when it holds none."""
    try:
        return _gap(_values(text))
    except _WRONG as error:
        raise BatchError(f"{text[:100]!r} is no gap: {error}") from error


def read_gaps(text: str) -> list[Gap]:
    """The gaps in the property's text; BatchError when it holds something else."""
    try:
        return [_gap(values) for values in _values(text)[:GAPS_PER_MESSAGE_MAX]]
    except _WRONG as error:
        raise BatchError(f"{text[:100]!r} holds no gaps: {error}") from error


def _values(text: str) -> Any:
    if len(text) > GAP_CHARACTERS_MAX:
        raise ValueError(f"{len(text)} characters are more than {GAP_CHARACTERS_MAX}")
    return read_json(text)


def _gap(values: Any) -> Gap:
    gap = read_gap(values["topic"], values)
    if not all(isinstance(text, str) for text in (gap.topic, gap.where, gap.why)):
        raise TypeError("topic, where and why are texts")
    if not all(type(number) is int and 0 <= number < 2**63 for number in (gap.count, gap.first, gap.last)):
        raise TypeError("count, first and last are numbers")
    return gap
