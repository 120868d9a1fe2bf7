"""Message types that nobody but their own image knows: where a chart may have them, and the words where it may not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotkube.registry.catalogue.core.expected_topics import IN, MQTT, OUT, ROS, TEXT, ExpectedTopic
from robotkube.registry.catalogue.core.message_types.carried import bridged_type
from robotkube.registry.catalogue.core.message_types.published import type_problems
from robotkube.robots.ros.core.known_types import is_packaged, unknown_type

OWN = "rover_msgs/msg/Fix"
KNOWN = "std_msgs/msg/String"
INPUT = ExpectedTopic("asked", ROS, IN, "/asked", KNOWN, causes="answered")
OUTPUT = ExpectedTopic("answered", ROS, OUT, "/answered", KNOWN)
CAUSELESS = ExpectedTopic("beside", ROS, OUT, "/beside", OWN)


def words(*topics: ExpectedTopic, images: tuple[str, ...] = ("rover",)) -> list[str]:
    return [f"{name}: {text}" for name, text in type_problems(topics, images)]


def test_types_are_known_by_package_and_message() -> None:
    assert [is_packaged(name) for name in (KNOWN, OWN, "std_msgs/msg/Strin", "std_msgs/String", "", "a/b/c/d")] == [
        True, False, False, True, False, False,
    ]  # fmt: skip
    assert unknown_type("std_msgs/msg/Floats") == (
        "type std_msgs/msg/Floats: package std_msgs has no message Floats "
        "(it has Float32, Float32MultiArray, Float64, Float64MultiArray)"
    )
    assert unknown_type("std_msgs/msg/Zero") == "type std_msgs/msg/Zero: package std_msgs has no message Zero"
    assert bridged_type(KNOWN) == ""


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        (replace(INPUT, type=OWN), "the suite interface must publish one"),
        (replace(OUTPUT, type=OWN), "the suite interface must see that an input leads to it"),
        (ExpectedTopic("sent", MQTT, OUT, "sent", OWN, encoding="rkf1"), "the suite interface must read it"),
        (ExpectedTopic("got", MQTT, IN, "got", OWN, encoding="rkf1"), "the suite interface must publish one"),
    ],
)
def test_what_the_suites_must_publish_or_read_is_refused(topic: ExpectedTopic, reason: str) -> None:
    rest = [one for one in (INPUT, OUTPUT) if one.interface != topic.interface]
    (text,) = words(topic, *rest)
    assert text.startswith(f"{topic.interface}: {topic.title}: type {OWN}: none of the packaged images has the message")
    assert f", and {reason}; take a type of docs/reference/message-types.md" in text
    assert text.endswith("may only be that of a ROS output that no input causes")


def test_an_image_of_its_own_may_give_out_what_it_likes() -> None:
    text_only = ExpectedTopic("text", MQTT, IN, "text", OWN, encoding=TEXT)
    assert words(INPUT, OUTPUT, CAUSELESS, text_only) == []


def test_packaged_images_do_not_even_give_it_out() -> None:
    (text,) = words(INPUT, OUTPUT, CAUSELESS, images=("ros",))
    assert "and the chart runs ros; take a type of" in text
    assert "your own" not in text
    assert words(CAUSELESS, images=()) == []
