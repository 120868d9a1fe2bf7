"""How much faster than real time `robotkube rule test` goes over the paper's bags: 15 vehicles at 100 Hz, two lidars.

Beside it, in the same run, what a user would write instead: the library rosbags as reader, every pose decoded, every
pair compared.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ci.folders import PROJECT
from robotkube.cli.rules import run
from robotkube.robots.bags.adapters.command_line_bags import Bags
from robotkube.robots.detector.core.settings import read_detector_settings
from scenarios import definition
from scenarios.generator import bags

FOLDER = PROJECT / "scenarios" / "pose-point-cloud-db-recording"
SETTINGS = ("encounters=1",)
POSE, PATTERN = "geometry_msgs/msg/PoseStamped", "/vehicles/{agent}/pose"
START_M, STOP_M = 400.0, 500.0
REPETITIONS = 3
RULES = {
    "name": "bench/rules",
    "topics": [{"name": PATTERN, "type": POSE}],
    "rules": [
        {
            "name": "near",
            "kind": "proximity",
            "topic": PATTERN,
            "start_distance_m": START_M,
            "stop_distance_m": STOP_M,
            "agents": ["vehicle-00", "vehicle-01"],
        }
    ],
}


@dataclass(frozen=True)
class RuleTest:
    """Factors are seconds of data per second of work, medians. `edges` were found by both."""

    realtime_factor: float
    baseline_realtime_factor: float
    seconds: float
    messages: int
    edges: int


def rule_test(settings: Sequence[str] = SETTINGS, repetitions: int = REPETITIONS) -> RuleTest:
    """Measure, in turns; the bags are made once and kept in the user's cache."""
    made = list(bags.make_bags(definition.load(FOLDER, settings), progress=lambda text: None).values())
    ours: list[float] = []
    theirs: list[float] = []
    for _ in range(repetitions):
        seconds, messages, edges = _timed(lambda: _ours(made), ours)
        _, _, expected = _timed(lambda: _theirs(made), theirs)
        if edges != expected:
            raise RuntimeError(f"rule test found {edges} edges, comparing every pair {expected}")
    return RuleTest(seconds / statistics.median(ours), seconds / statistics.median(theirs), seconds, messages, edges)


Result = tuple[float, int, int]
"""Seconds of data, messages that were looked at, edges."""


def _timed(work: Callable[[], Result], times: list[float]) -> Result:
    began = time.perf_counter()
    result = work()
    times.append(time.perf_counter() - began)
    return result


def _ours(made: Sequence[Path]) -> Result:
    problems: list[str] = []
    with Bags(made, problems.append) as bags:
        result = run(read_detector_settings(RULES, "rules"), bags)
    if problems:
        raise RuntimeError(problems[0])
    return (result.last - result.first) / 1e9, result.messages, len(result.edges)


def _theirs(made: Sequence[Path]) -> Result:
    places: dict[str, tuple[float, float, float]] = {}
    watched = ("/vehicles/vehicle_00/pose", "/vehicles/vehicle_01/pose")
    near = False
    messages = 0
    edges = 0
    first = None
    last = 0
    with AnyReader(list(made), default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        chosen = [connection for connection in reader.connections if connection.msgtype == POSE]
        for connection, moment, data in reader.messages(chosen):
            decoded: Any = reader.deserialize(data, connection.msgtype)
            position = decoded.pose.position
            places[connection.topic] = position.x, position.y, position.z
            messages, first, last = messages + 1, moment if first is None else first, moment
            if connection.topic in watched and all(name in places for name in watched):
                distance = math.dist(places[watched[0]], places[watched[1]])
                changed = distance > STOP_M if near else distance < START_M
                near, edges = near != changed, edges + changed
    return (last - (first or 0)) / 1e9, messages, edges


if __name__ == "__main__":
    print(rule_test())
