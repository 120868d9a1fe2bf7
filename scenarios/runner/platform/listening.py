"""Listening on an agent: a program that reads a ROS topic inside one of its pods and prints what comes."""

from __future__ import annotations

import base64
from collections.abc import Sequence

from scenarios.runner.platform.access import Access, pod_ready

BRIDGE = "mqtt-bridge"  # every agent that hears of others has one
HEAR_SECONDS_MAX = 10.0
END_SECONDS_MAX = 15.0

PROGRAM = """
import base64, sys, time
from robotkube.robots.ros.adapters.rclpy_node import RosNode
topic, kind, count, seconds = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
heard, end = RosNode("story_listener").subscribe(topic, kind), time.monotonic() + seconds
while count > 0 and time.monotonic() < end:
    for data in heard.take():
        print(base64.b64encode(data).decode(), flush=True)
        count -= 1
    time.sleep(0.02)
"""
"""Everything that speaks ROS has the module that it imports."""


def arguments(topic: str, type_name: str, count: int, seconds: float) -> list[str]:
    """The program's command line for `count` messages, for which it waits at most so long."""
    return ["python3", "-c", PROGRAM, topic, type_name, str(count), str(seconds)]


def messages(output: str) -> Sequence[bytes]:
    """The serialised messages that it printed."""
    return [base64.b64decode(line) for line in output.split()]


def heard(access: Access, agent: str, topic: str, type_name: str, count: int) -> Sequence[bytes]:
    """Messages of a topic that services on an agent hear now, at most `count`; none while nothing there can listen."""
    pods = [
        pod.metadata.name
        for pod in access.pods(agent)
        if (pod.metadata.labels or {}).get("app.kubernetes.io/name") == BRIDGE and pod_ready(pod)
    ]
    if not pods:
        return ()
    command = arguments(topic, type_name, count, HEAR_SECONDS_MAX)
    return messages(access.run_inside(agent, pods[0], command, HEAR_SECONDS_MAX + END_SECONDS_MAX))
