"""The settings of object-detection and object-tracking, read from `config.yaml`, or every problem in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import ROS_TOPIC
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.perception.core.detection import METHODS, ObjectCriteria
from robotkube.robots.perception.core.tracking import MOTIONS, TrackerSettings

RANGE_M_MAX = 500.0
GATE_M_MAX = 100.0
GAP_SECONDS_MAX = 60.0
POINTS_MAX = 100_000

_METHOD = re.compile("|".join(METHODS))
_MOTION = re.compile("|".join(MOTIONS))


@dataclass(frozen=True)
class DetectionSettings:
    """The settings of object-detection: topics of one sensor (cloud in, objects and uncertainty out), and the criteria
    of an object."""

    cloud: str
    objects: str
    uncertainty: str
    criteria: ObjectCriteria


@dataclass(frozen=True)
class TrackingSettings:
    """The settings of object-tracking: topics of one sensor (objects in, tracks out), and those of the tracker."""

    objects: str
    tracks: str
    tracker: TrackerSettings


def read_detection_settings(document: Mapping[str, Any], where: str) -> DetectionSettings:
    """The settings of object-detection in a document; DocumentError names `where` and every problem."""
    reader = Reader(where)
    keys = ["cloud", "objects", "uncertainty", "method", "rangeMetres", "pointsMin"]
    values = reader.mapping(document, "", keys)
    settings = DetectionSettings(
        cloud=reader.text(values.get("cloud"), "cloud", ROS_TOPIC),
        objects=reader.text(values.get("objects"), "objects", ROS_TOPIC),
        uncertainty=reader.text(values.get("uncertainty"), "uncertainty", ROS_TOPIC),
        criteria=ObjectCriteria(
            method=reader.text(values.get("method"), "method", _METHOD),
            range_m=_number(reader, values, "rangeMetres", 1, RANGE_M_MAX),
            points_min=int(_number(reader, values, "pointsMin", 2, POINTS_MAX)),
        ),
    )
    _distinct(reader, {key: values.get(key) for key in keys[:3]})
    reader.finish()
    return settings


def read_tracking_settings(document: Mapping[str, Any], where: str) -> TrackingSettings:
    """The settings of object-tracking in a document; DocumentError names `where` and every problem."""
    reader = Reader(where)
    values = reader.mapping(document, "", ["objects", "tracks", "motion", "gateMetres", "gapSeconds"])
    settings = TrackingSettings(
        objects=reader.text(values.get("objects"), "objects", ROS_TOPIC),
        tracks=reader.text(values.get("tracks"), "tracks", ROS_TOPIC),
        tracker=TrackerSettings(
            motion=reader.text(values.get("motion"), "motion", _MOTION),
            gate_m=_number(reader, values, "gateMetres", 0.1, GATE_M_MAX),
            gap_seconds=_number(reader, values, "gapSeconds", 0.01, GAP_SECONDS_MAX),
        ),
    )
    _distinct(reader, {key: values.get(key) for key in ("objects", "tracks")})
    reader.finish()
    return settings


def _number(reader: Reader, values: Mapping[str, Any], key: str, least: float, most: float) -> float:
    """The number of a key; `least` when it is missing or beyond its bounds, which is a problem of the reader."""
    value = values.get(key)
    if isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most:
        return value
    if value is not None:
        reader.problems.append(f"{key}: {value!r} must be a number from {least:g} to {most:g}")
    return least


def _distinct(reader: Reader, topics: Mapping[str, Any]) -> None:
    """Note a problem for each key whose topic is another key's, too."""
    for key, topic in topics.items():
        if topic is not None and list(topics.values()).count(topic) > 1:
            reader.problems.append(f"{key}: {topic} has another use in these settings; give every topic one")
