"""The settings of object-tracking, read from `config.yaml`, or every problem in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.patterns import ROS_TOPIC
from robotkube.foundation.documents.core.reader import Reader
from robotkube.robots.perception.core.settings import note_topics, read_number
from robotkube.robots.perception.core.tracking import MOTIONS, TrackerSettings

GATE_M_MAX = 100.0
GAP_SECONDS_MAX = 60.0

_MOTION = re.compile("|".join(MOTIONS))


@dataclass(frozen=True)
class TrackingSettings:
    """The settings of object-tracking: topics of one sensor (objects in, tracks out), and those of the tracker."""

    objects: str
    tracks: str
    tracker: TrackerSettings


def read_tracking_settings(document: Mapping[str, Any], where: str) -> TrackingSettings:
    """The settings of object-tracking in a document; DocumentError names `where` and every problem."""
    reader = Reader(where)
    values = reader.mapping(document, "", ["objects", "tracks", "motion", "gateMetres", "gapSeconds"])
    settings = TrackingSettings(
        objects=reader.text(values.get("objects"), "objects", ROS_TOPIC),
        tracks=reader.text(values.get("tracks"), "tracks", ROS_TOPIC),
        tracker=TrackerSettings(
            motion=reader.text(values.get("motion"), "motion", _MOTION),
            gate_m=read_number(reader, values, "gateMetres", 0.1, GATE_M_MAX),
            gap_seconds=read_number(reader, values, "gapSeconds", 0.01, GAP_SECONDS_MAX),
        ),
    )
    note_topics(reader, {key: values.get(key) for key in ("objects", "tracks")})
    reader.finish()
    return settings
