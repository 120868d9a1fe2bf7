"""The settings of object-detection, read from `config.yaml`, or every problem in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import ROS_TOPIC
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.perception.core.detection import METHODS, ObjectCriteria
from robotkube.robots.perception.core.settings import note_topics, read_number

RANGE_M_MAX = 500.0
POINTS_MAX = 100_000

_METHOD = re.compile("|".join(METHODS))


@dataclass(frozen=True)
class DetectionSettings:
    """The settings of object-detection: topics of one sensor (cloud in, objects and uncertainty out), and the criteria
    of an object."""

    cloud: str
    objects: str
    uncertainty: str
    criteria: ObjectCriteria


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
            range_m=read_number(reader, values, "rangeMetres", 1, RANGE_M_MAX),
            points_min=int(read_number(reader, values, "pointsMin", 2, POINTS_MAX)),
        ),
    )
    note_topics(reader, {key: values.get(key) for key in keys[:3]})
    reader.finish()
    return settings
