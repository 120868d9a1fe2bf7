"""Message types in a chart's interfaces that its images do not know, or that the suite `interface`, whose observer is a
packaged image, could neither publish nor read."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from robotkube.registry.catalogue.core.expected_topics import IN, MQTT, ROS, TEXT, ExpectedTopic
from robotkube.robots.ros.core.known_types import instead, is_packaged, unknown_type
from robotkube.robots.ros.core.packaged_types import PACKAGED_IMAGES

OWN_OUTPUT = "a type of your own may only be that of a ROS output that no input causes"


def only_packaged(images: Collection[str]) -> bool:
    """Return whether all images of a chart are packaged ones, by their names."""
    return bool(images) and PACKAGED_IMAGES.issuperset(images)


def type_problems(expected: Sequence[ExpectedTopic], images: Collection[str]) -> Iterator[tuple[str, str]]:
    """Interface and words for every topic whose type cannot be tried; `images` are the names of the chart's images."""
    for topic in expected:
        if topic.type and not is_packaged(topic.type):
            reason = _hindrance(topic, expected, images)
            if reason:
                yield topic.interface, f"{topic.title}: {unknown_type(topic.type)}, {reason}; {_fix(images)}"


def _hindrance(topic: ExpectedTopic, expected: Sequence[ExpectedTopic], images: Collection[str]) -> str:
    """Why the type is needed outside of the chart's own image; empty when it is not."""
    if topic.medium == MQTT and topic.encoding == TEXT:
        return ""
    if topic.medium == ROS and only_packaged(images):
        return f"and the chart runs {', '.join(images)}"
    if topic.direction == IN:
        return "and the suite interface must publish one"
    if topic.medium == MQTT:
        return "and the suite interface must read it"
    if any(other.direction == IN and other.causes == topic.interface for other in expected):
        return "and the suite interface must see that an input leads to it"
    return ""


def _fix(images: Collection[str]) -> str:
    return instead() if only_packaged(images) else f"{instead()}; {OWN_OUTPUT}"
