"""A rule of one's own: two vehicles approach each other faster than a bound.

No single message holds the speed at which two vehicles approach; it is how much their distance has shrunk within
`span_seconds`, from both positions interpolated at the same two moments.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from robotkube.plugins import Arrival, Cause, Holding, Window

FIELDS = ("pose.position.x", "pose.position.y")
REQUIRED = ("topic", "start_mps", "stop_mps")


class ClosingSpeed:
    """Settings: `topic` (pattern of the poses), `start_mps` and `stop_mps` (metres a second), `span_seconds`."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        missing = [key for key in REQUIRED if key not in settings]
        if missing:
            raise ValueError(
                f"settings: {', '.join(missing)} missing; give the poses' topic and speeds in metres a second"
            )
        self._topic = str(settings["topic"])
        self._start, self._stop = float(settings["start_mps"]), float(settings["stop_mps"])
        self._span_ns = int(float(settings.get("span_seconds", 0.5)) * 1e9)
        if not 0 <= self._stop <= self._start:
            raise ValueError("stop_mps must not be more than start_mps, nor less than 0")

    def evaluate(self, arrival: Arrival, window: Window) -> Iterator[Holding]:
        """For every other vehicle whose positions are known at both moments."""
        for other, topic in window.topics(self._topic).items():
            latest = window.latest(topic, FIELDS)
            if other == arrival.agent or latest is None:
                continue
            now = min(arrival.stamp, latest.stamp)
            before, after = (self._distance(window, arrival.topic, topic, at) for at in (now - self._span_ns, now))
            if before is None or after is None:
                continue
            speed = (before - after) / (self._span_ns / 1e9)
            if speed > self._start or speed < self._stop:
                cause = Cause(topic, latest.stamp, {"closing_mps": speed, "distance_m": after})
                detail = {"closing_mps": speed, "distance_m": after}
                yield Holding((arrival.agent, other), speed > self._start, detail, (cause,))

    def _distance(self, window: Window, one: str, other: str, stamp: int) -> float | None:
        places = [window.at(topic, stamp, FIELDS) for topic in (one, other)]
        if places[0] is None or places[1] is None:
            return None
        return math.dist(places[0].values, places[1].values)


def make(settings: Mapping[str, Any]) -> ClosingSpeed:
    """What the entry point names."""
    return ClosingSpeed(settings)
