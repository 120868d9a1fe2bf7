"""A topic is as long as ROS takes it, wherever one is named: what is longer is refused in words."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import pytest
import yaml

from robotkube.errors import DocumentError
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.core.patterns import ROS_TOPIC_CHARACTERS_MAX
from robotkube.registry.catalogue.core.expected_topics import expected_topics
from robotkube.registry.catalogue.core.links.chains import chain_document
from robotkube.robots.bridge.core.settings import read_bridge_settings
from robotkube.robots.perception.core.tracking_settings import read_tracking_settings
from robotkube.robots.ros.core.topic_patterns import TopicPattern

LONGEST = f"/{'x' * (ROS_TOPIC_CHARACTERS_MAX - 1)}"
TOPIC = {"type": "std_msgs/msg/String", "qos": {"reliability": "reliable", "durability": "volatile"}}


def declared(topic: str) -> Any:
    interface = {"name": "said", "medium": "ros", "direction": "out", "topic": topic, **TOPIC}
    return expected_topics([interface], {}, Jinja2Templates().render)


def bridged(topic: str) -> Any:
    return read_bridge_settings({"agent": "vehicle-00", "out": [{"name": topic, "type": TOPIC["type"]}]}, "bridge")


def tracked(topic: str) -> Any:
    motion = {"motion": "still", "gateMetres": 4, "gapSeconds": 1}
    return read_tracking_settings({"objects": "/v/objects", "tracks": topic, **motion}, "config.yaml")


@pytest.mark.parametrize("read", [TopicPattern, declared, bridged, tracked])
def test_a_topic_is_as_long_as_ros_takes_it(read: Callable[[str], Any]) -> None:
    read(LONGEST)
    with pytest.raises(
        (ValueError, DocumentError), match=r"has 248 characters, and .* takes 247; give it a shorter name"
    ):
        read(f"{LONGEST}x")


def test_a_name_in_braces_counts_as_the_shortest_that_can_stand_for_it() -> None:
    TopicPattern(f"{LONGEST[:-2]}/{{agent}}")
    with pytest.raises(ValueError, match="and ROS takes 247"):
        TopicPattern(f"{LONGEST}/{{agent}}")


def test_what_registry_new_writes_has_the_same_limit() -> None:
    """A chart of its own took 255, and its process refused what its schema had taken."""
    skeleton = files("robotkube.registry.catalogue") / "skeletons" / "application"
    schema = json.loads((skeleton / "chart" / "values.schema.json").read_text())
    relay = schema["properties"]["relay"]["properties"]
    single = yaml.safe_load((skeleton / "application.yaml").read_text())
    chain = yaml.safe_load(chain_document("delivery", ["order", "plan"], "text/relay"))
    for topics in (relay, *(one["spec"]["parameters"]["properties"] for one in (single, chain))):
        assert {name: topic["maxLength"] for name, topic in topics.items()} == {
            "input": ROS_TOPIC_CHARACTERS_MAX,
            "output": ROS_TOPIC_CHARACTERS_MAX,
        }
