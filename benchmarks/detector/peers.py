"""The other ends of a detector in measurements, and the detector itself with a clock at its reactions.

    python3 -m benchmarks.detector.peers source RESULT --agents 15 --rate 1500 --count 15000 [--swing 10]
    python3 -m benchmarks.detector.peers drain RESULT --agents 15
    python3 -m benchmarks.detector.peers detector RESULT
    python3 -m benchmarks.detector.peers activated RESULT

`source` publishes poses of all agents in turn, `rate` a second altogether, once somebody subscribes to each of them;
with `--swing n` every agent goes near its neighbours and away again every n messages, and `--clouds n` of them publish
a cloud of 320 kB with each tenth pose. `drain` takes and counts, nothing
else: what receiving costs at least in Python. `detector` is the detector's process, which also notes how long after the
reception of a message its event was raised; `activated` notes how it becomes active. With `--early` the source does
not wait for subscriptions. RESULT is JSON, written at the end.
"""

from __future__ import annotations

import argparse
import json
import resource
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.measuring.bags import CLOUD_TYPE, POSE_TYPE, message
from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.detector.__main__ import BUSY_SECONDS
from robotkube.robots.detector.__main__ import body as detect
from robotkube.robots.detector.core.settings import ACTIVE
from robotkube.robots.detector.loops.detector import EventDetector
from robotkube.robots.detector.loops.dispatching import Dispatcher
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.rules.core import Edge

DEPTH, CLOUDS_DEPTH, CLOUD_BYTES = 20_000, 10, 320_000
MATCH_SECONDS_MAX = 60.0
SETTLE_SECONDS = 1.0
PERIOD_SECONDS = 0.005
GRACE_SECONDS = 9.0
_HEAD, _POSE = struct.Struct("<iII4s"), struct.Struct("<7d")


def topic(number: int) -> str:
    """The pose topic of an agent."""
    return f"/vehicles/vehicle_{number:02d}/pose"


def pose(stamp: int, x: float) -> bytes:
    """A serialised PoseStamped."""
    head = _HEAD.pack(stamp // 10**9, stamp % 10**9, 4, b"map\0")
    return b"\0\1\0\0" + head + _POSE.pack(x, 0, 0, 0, 0, 0, 1)


def cloud_topic(number: int) -> str:
    """The cloud topic of an agent."""
    return f"/vehicles/vehicle_{number:02d}/lidar_center/pointcloud"


def place(agent: int, number: int, swing: int) -> float:
    """The place of an agent: far from everybody, or every second time on the neighbour's place."""
    away = bool(swing) and agent % 2 == 1 and number // swing % 2 == 1
    return 10_000.0 * (agent - 1 if away else agent)


def source(process: Process, options: argparse.Namespace) -> Mapping[str, Any]:
    """Publishes."""
    node = RosNode("source")
    outputs = [node.advertise(topic(number), POSE_TYPE, depth=DEPTH) for number in range(options.agents)]
    clouds = [node.advertise(cloud_topic(number), CLOUD_TYPE, depth=CLOUDS_DEPTH) for number in range(options.clouds)]
    deadline = time.monotonic() + MATCH_SECONDS_MAX
    while not options.early and not all(output.matched for output in outputs + clouds) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(SETTLE_SECONDS)
    began = time.monotonic()
    first = time.time_ns()
    done = 0
    while done < options.count and not process.stopping.is_set():
        due = min(options.count, int((time.monotonic() - began) * options.rate) + 1)
        for number in range(done, due):
            agent, turn = number % options.agents, number // options.agents
            outputs[agent].publish(pose(time.time_ns(), place(agent, turn, options.swing)))
            if agent < options.clouds and turn % 10 == 0:
                clouds[agent].publish(message(turn, time.time_ns(), CLOUD_BYTES))
        done = due
        time.sleep(PERIOD_SECONDS)
    result = {"messages": done, "first": first, "last": time.time_ns()}
    Path(options.result).write_text(json.dumps(result))
    process.stopping.wait(MATCH_SECONDS_MAX)  # what was lost on the way is asked for once more
    return result


def drain(process: Process, options: argparse.Namespace) -> Mapping[str, Any]:
    """Takes and counts."""
    node = RosNode("drain")
    inputs = [node.subscribe(topic(number), POSE_TYPE, depth=DEPTH) for number in range(options.agents)]
    messages, before = 0, 0.0
    while not process.stopping.wait(BUSY_SECONDS):
        taken = sum(len(one.take()) for one in inputs)
        if taken and not messages:
            before = _cpu_seconds()
        messages += taken
    return {"messages": messages, "cpu_seconds": _cpu_seconds() - before}


def measured(process: Process, options: argparse.Namespace) -> Mapping[str, Any]:
    """The detector."""
    latencies: list[int] = []
    react = Dispatcher.react

    def timed(self: Dispatcher, edge: Edge) -> None:
        latencies.append(time.time_ns() - edge.time)
        react(self, edge)

    Dispatcher.react = timed  # type: ignore[method-assign]
    detect(process)
    return {"latencies_ns": latencies}


def activated(process: Process, options: argparse.Namespace) -> Mapping[str, Any]:
    """The detector, which notes of each time it became active when that was asked for, since when it was, and when the
    first message was taken after it; ns since 1970."""
    activations: list[tuple[int, int, int]] = []
    turn = EventDetector.turn

    def timed(self: EventDetector) -> int:
        total = turn(self)
        if total and self.state == ACTIVE and (not activations or activations[-1][0] != self.reached.asked):
            activations.append((self.reached.asked, self.reached.since, time.time_ns()))
        return total

    EventDetector.turn = timed  # type: ignore[method-assign]
    detect(process)
    return {"activations": activations}


def _cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


ROLES = {"source": source, "drain": drain, "detector": measured, "activated": activated}


def main() -> None:
    """Play one role until it is over."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=ROLES)
    parser.add_argument("result")
    parser.add_argument("--agents", type=int, default=15)
    parser.add_argument("--rate", type=float, default=1500.0)
    parser.add_argument("--count", type=int, default=15_000)
    parser.add_argument("--swing", type=int, default=0)
    parser.add_argument("--clouds", type=int, default=0)
    parser.add_argument("--early", action="store_true")
    options = parser.parse_args()

    def body(process: Process) -> None:
        Path(options.result).write_text(json.dumps(ROLES[options.role](process, options)))

    run(options.role, body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
