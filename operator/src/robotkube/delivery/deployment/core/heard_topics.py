"""Topics that a release brings in from the broker, as its values say.

    bridge:   {in: [{name: /vehicles/vehicle_01/pose, mqtt_topic: ...}]}         a bridge, at the end of links
    detector: {topics: [{name: "/vehicles/{agent}/pose", source: mqtt}]}         a detector that reads the broker itself

They are read by this form, whatever the chart is: a chart of one's own that takes its topics under `bridge.in` is a
bridge like ours.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import MQTT_TOPIC, ROS_TOPIC_PATTERN
from robotkube.robots.bridge.core.settings import GATEWAY_TOPICS, BridgedTopic
from robotkube.robots.ros.core.topic_patterns import AGENT

OF_NOBODY = ("robotkube/", "mqtt_client/", "+")
"""Beginnings of filters of which nobody is given one by itself: the task gateway, what says types, and any of these."""


@dataclass(frozen=True)
class HeardTopic:
    """One topic: `where` it stands in the values, `name` in ROS, `filter` at the broker; empty when it is no topic that
    can be given to hear."""

    where: str
    name: str
    filter: str


def heard_topics(values: Mapping[str, Any]) -> Iterator[HeardTopic]:
    """What the values of a release say it hears, without the task gateway's topics: everybody has his own."""
    for where, item in _read_topics(values):
        name = item.get("name") if isinstance(item, Mapping) else None
        if name not in GATEWAY_TOPICS:
            yield HeardTopic(where, str(name), _filter(item))


def _read_topics(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for index, item in enumerate(_items(values, "bridge", "in")):
        yield f"bridge.in[{index}]", item
    for index, item in enumerate(_items(values, "detector", "topics")):
        if isinstance(item, Mapping) and item.get("source") == "mqtt":
            yield f"detector.topics[{index}]", {"name": item.get("name")}


def _items(values: Mapping[str, Any], outer: str, inner: str) -> list[Any]:
    mapping = values.get(outer)
    items = mapping.get(inner) if isinstance(mapping, Mapping) else None
    return items if isinstance(items, list) else []


def _filter(item: Any) -> str:
    """The filter at the broker of a topic in a release's values; empty when there is none to be given."""
    name = item.get("name") if isinstance(item, Mapping) else None
    if not isinstance(name, str) or not ROS_TOPIC_PATTERN.fullmatch(name) or name.count(AGENT) > 1:
        return ""
    other = item.get("mqtt_topic") or ""
    if other and not (isinstance(other, str) and MQTT_TOPIC.fullmatch(other)):
        return ""
    topic = BridgedTopic(name, "", mqtt_topic=other).filter
    return "" if topic.startswith(OF_NOBODY) else topic
