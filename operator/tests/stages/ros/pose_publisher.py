"""Publishes poses, clouds and a latched transform on real ROS topics, on a grid of stamps, and keeps a ledger.

    python -m tests.stages.ros.pose_publisher FOLDER SECONDS

writes FOLDER/<topic with / as __>.jsonl, says "publishing" when it begins; SIGTERM ends it earlier, with complete
ledgers.

vehicle-01 swings past vehicle-00 with a period of 6 s: near, far, near. While there is FOLDER/place, it is so many
metres away from it as stands there.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
import struct
import sys
import time
from pathlib import Path
from typing import IO

from robotkube.robots.ros.adapters.rclpy_node import RosNode

PERIOD_NS = 10_000_000
AGENTS = ("vehicle_00", "vehicle_01")
POSE, CLOUD = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/PointCloud2"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
CLOUD_POINTS = 5000
PLACE = "place"


def header(stamp: int, frame: bytes) -> bytes:
    return struct.pack("<iII", stamp // 10**9, stamp % 10**9, len(frame) + 1) + frame + b"\0"


def pose(stamp: int, x: float) -> bytes:
    body = header(stamp, b"map")
    return b"\0\1\0\0" + body + bytes(-len(body) % 8) + struct.pack("<7d", x, 0, 0, 0, 0, 0, 1)


def transform(stamp: int, child: bytes) -> bytes:
    body = header(stamp, b"base")
    body += bytes(-len(body) % 4) + struct.pack("<I", len(child) + 1) + child + b"\0"
    return b"\0\1\0\0" + body + bytes(-len(body) % 8) + struct.pack("<7d", 1, 0, 2, 0, 0, 0, 1)


def cloud(stamp: int) -> bytes:
    body = header(stamp, b"lidar")
    body += bytes(-len(body) % 4) + struct.pack("<III", 1, CLOUD_POINTS, 0)
    body += struct.pack("<BxxxIII", 0, 16, 16 * CLOUD_POINTS, 16 * CLOUD_POINTS)
    return b"\0\1\0\0" + body + os.urandom(16) * CLOUD_POINTS + b"\1"


def distance(folder: Path, seconds: float) -> float:
    try:
        return float((folder / PLACE).read_text())
    except FileNotFoundError:
        return 800.0 * math.sin(2 * math.pi * seconds / 6 + math.pi / 2)


class Ledgers:
    """One line per published message, a closing line at the end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, tuple[IO[str], list[int]]] = {}

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        if topic not in self._files:
            path = self._folder / f"{topic.replace('/', '__')}.jsonl"
            self._files[topic] = (path.open("w", buffering=1), [0])
        file, count = self._files[topic]
        line = {"sequence": count[0], "stamp": stamp, "sha256": hashlib.sha256(data).hexdigest()}
        file.write(json.dumps(line) + "\n")
        count[0] += 1

    def close(self) -> None:
        for file, count in self._files.values():
            file.write(json.dumps({"end": True, "count": count[0]}) + "\n")
            file.close()


def main(folder: Path, seconds: float) -> None:
    node = RosNode(f"publisher_{os.getpid()}")
    ledgers = Ledgers(folder)
    poses = {a: node.advertise(f"/vehicles/{a}/pose", POSE) for a in AGENTS}
    clouds = {a: node.advertise(f"/vehicles/{a}/cloud", CLOUD, depth=50) for a in AGENTS}
    latched = {
        a: node.advertise(f"/vehicles/{a}/transform", TRANSFORM, durability="transient_local", depth=1) for a in AGENTS
    }
    ending: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ending.append(number))
    start = time.time_ns()
    for agent, publisher in latched.items():
        publisher.publish(data := transform(start, agent.encode()))
        ledgers.write(publisher.topic, start, data)
    print("publishing", flush=True)
    for step in range(int(seconds * 1e9 / PERIOD_NS)):
        if ending:
            break
        stamp = start + step * PERIOD_NS
        time.sleep(max(0.0, (stamp - time.time_ns()) / 1e9))
        for number, (agent, publisher) in enumerate(poses.items()):
            x = distance(folder, (stamp - start) / 1e9) if number else 0.0
            publisher.publish(data := pose(stamp, x))
            ledgers.write(publisher.topic, stamp, data)
            if step % 10 == 0:
                clouds[agent].publish(data := cloud(stamp))
                ledgers.write(clouds[agent].topic, stamp, data)
    ledgers.close()
    time.sleep(1.0)  # the middleware may still be sending
    os._exit(0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
