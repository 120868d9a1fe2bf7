"""The end of a detector's process: what still arrives while recordings go on."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robotkube.entrypoints.detector import _end
from robotkube.entrypoints.processes import Process
from robotkube.services.event_detector import EventDetector


class Detector:
    """Takes messages until it is stopped; one is published after the first turn."""

    def __init__(self, after_seconds: float) -> None:
        self.after_seconds, self.published, self.taken, self.stopped_at = after_seconds, 0, 0, 0.0
        self.recordings = (SimpleNamespace(stop=self.stop),)

    def turn(self) -> int:
        found, self.published = self.published - self.taken, 1
        self.taken += found
        return found

    def stop(self, seconds_max: float) -> bool:
        self.stopped_at = time.monotonic()
        return seconds_max > 0


@pytest.mark.parametrize(("after_seconds", "taken"), [(0.6, 1), (0.0, 0)])
def test_what_comes_after_the_end_was_asked_for_is_recorded(after_seconds: float, taken: int) -> None:
    detector = Detector(after_seconds)
    lines: list[dict[str, Any]] = []
    process = SimpleNamespace(log=lambda _, **values: lines.append(values))
    asked = time.monotonic()
    _end(cast(Process, process), cast(EventDetector, detector))
    assert detector.taken == taken
    assert detector.stopped_at - asked >= after_seconds
    assert lines == [{"recordings": 1, "complete": True}]
