"""What the settings of object-detection and of object-tracking have in common: bounded numbers, topics that differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.ros.core.topic_patterns import length_problem


def read_number(reader: Reader, values: Mapping[str, Any], key: str, least: float, most: float) -> float:
    """The number of a key; `least` when it is missing or beyond its bounds, which is a problem of the reader."""
    value = values.get(key)
    if isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most:
        return value
    if value is not None:
        reader.problems.append(f"{key}: {value!r} must be a number from {least:g} to {most:g}")
    return least


def note_topics(reader: Reader, topics: Mapping[str, Any]) -> None:
    """Note a problem for each key whose topic is another key's, too, or too long for ROS."""
    for key, topic in topics.items():
        if topic is not None and list(topics.values()).count(topic) > 1:
            reader.problems.append(f"{key}: {topic} has another use in these settings; give every topic one")
        if isinstance(topic, str) and (problem := length_problem(topic)):
            reader.problems.append(f"{key}: {topic:.60}... {problem}")
