"""What speaks, answers and hears beside the bridges of `benchmarks.broker.links`, on ROS.

    python3 -m benchmarks.broker.link_peers say TOPIC --count 3000  100 poses a second, stamped with their time
    python3 -m benchmarks.broker.link_peers relay TOPIC OTHER   each pose again under another name, as a service would
    python3 -m benchmarks.broker.link_peers hear RESULT TOPIC... --count 3000

Before the poses that count, WARMING_UP others are said, since DDS needs a while to find who is there. `hear` ends when
it has all that count; RESULT is JSON: topic -> their ages in ms, each pose once.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from benchmarks.bridges.peers import NUMBER_PLACE, POSE_BYTES
from benchmarks.measuring.bags import POSE_TYPE, message
from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.ros.core.common_messages import header_stamp

HERTZ = 100
WARMING_UP = 500
PERIOD_SECONDS = 0.002


def say(process: Process, topics: list[str], count: int) -> None:
    """Publish at the rate, and stay until told to end: what was lost on the way may be asked for again."""
    output = RosNode("speaker").advertise(topics[0], POSE_TYPE)
    began = time.monotonic()
    for number in range(WARMING_UP + count):
        if process.stopping.wait(max(0.0, began + number / HERTZ - time.monotonic())):
            return
        output.publish(message(number, time.time_ns(), POSE_BYTES))
    process.stopping.wait()


def relay(process: Process, topics: list[str], count: int) -> None:
    """Publish what comes under the other name."""
    node = RosNode("relay")
    source = node.subscribe(topics[0], POSE_TYPE)
    target = node.advertise(topics[1], POSE_TYPE)
    while not process.stopping.wait(PERIOD_SECONDS):
        for data in source.take():
            target.publish(data)


def hear(process: Process, topics: list[str], count: int) -> None:
    """Note ages, and write them when all that count are there."""
    result, *names = topics
    node = RosNode("listener")
    sources = {name: node.subscribe(name, POSE_TYPE) for name in names}
    ages: dict[str, dict[int, float]] = {name: {} for name in names}
    while not process.stopping.wait(PERIOD_SECONDS) and any(len(known) < count for known in ages.values()):
        for name, source in sources.items():
            for data in source.take():
                number = int.from_bytes(data[NUMBER_PLACE], "little")
                if number >= WARMING_UP:
                    ages[name].setdefault(number, (time.time_ns() - header_stamp(data)) / 1e6)
    unfinished = Path(f"{result}.part")
    unfinished.write_text(json.dumps({name: list(known.values()) for name, known in ages.items()}))
    unfinished.rename(result)


ROLES = {"say": say, "relay": relay, "hear": hear}


def body(process: Process) -> None:
    """Play the role."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=sorted(ROLES))
    parser.add_argument("topics", nargs="+")
    parser.add_argument("--count", type=int, default=0)
    options = parser.parse_args()
    ROLES[options.role](process, options.topics, options.count)


if __name__ == "__main__":
    run("link-peer", body, 3.0)
