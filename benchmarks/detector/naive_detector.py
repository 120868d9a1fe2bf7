"""The detector one would write first, as a baseline: subscriptions with callbacks in a SingleThreadedExecutor, as in
common tutorials; each callback gets a decoded message, keeps it, and compares the distance to every other vehicle.

    python3 -m benchmarks.detector.naive_detector

Takes the topics and the rule of our detector's settings. With ROBOTKUBE_RESULT it writes there, at SIGTERM, how many
messages it got and what processor time it took for them.
"""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor

from benchmarks.bridges.naive_bridge import kind

SPIN_SECONDS = 0.1


class NaiveDetector:
    """The last pose of each vehicle and the pairs that are near."""

    def __init__(self, rule: dict[str, Any]) -> None:
        self._rule = rule
        self._last: dict[str, Any] = {}
        self._near: set[tuple[str, str]] = set()
        self.messages = 0
        self.first = 0.0

    def callback(self, agent: str) -> Callable[[Any], None]:
        """What the executor calls for the vehicle's poses."""

        def compare(message: Any) -> None:
            self.first = self.first or time.process_time()
            self.messages += 1
            self._last[agent] = message
            here = message.pose.position
            for other, pose in self._last.items():
                if other == agent:
                    continue
                there = pose.pose.position
                pair = (min(agent, other), max(agent, other))
                distance = math.dist((here.x, here.y, here.z), (there.x, there.y, there.z))
                if pair not in self._near and distance < self._rule["start_distance_m"]:
                    self._near.add(pair)
                elif pair in self._near and distance > self._rule["stop_distance_m"]:
                    self._near.remove(pair)

        return compare


def main() -> None:
    """Runs until it is told to end."""
    settings = yaml.safe_load(Path(os.environ["ROBOTKUBE_CONFIG"]).read_text())
    [rule], [topic] = settings["rules"], settings["topics"]
    ended: list[int] = []
    rclpy.init()
    signal.signal(signal.SIGTERM, lambda number, _: ended.append(number))
    node = rclpy.create_node("naive_detector")
    detector = NaiveDetector(rule)
    for agent in rule["agents"]:
        name = rule["topic"].replace("{agent}", agent.replace("-", "_"))
        node.create_subscription(kind(topic["type"]), name, detector.callback(agent), int(topic.get("depth", 1000)))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not ended:
        executor.spin_once(SPIN_SECONDS)
    if path := os.environ.get("ROBOTKUBE_RESULT"):
        result = {"messages": detector.messages, "cpu_seconds": time.process_time() - detector.first}
        Path(path).write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    main()
