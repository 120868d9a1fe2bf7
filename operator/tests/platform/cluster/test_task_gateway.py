"""The task gateway on the whole platform: a ROS node on a vehicle asks, hears, and takes it back. What cannot become a
task: delivery/tasks/test_mqtt_gateway_processes.py."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import DEPLOYED_SECONDS_MAX, Stage

AGENT, BRIDGE = "vehicle-00", "vehicle-00/mqtt-bridge"
RECORDER = "cloud-0/recorder-vehicle-00-vehicle-01"
ANSWER_SECONDS_MAX = 90
TASK = {
    "metadata": {"name": "asked-by-ros"},
    "spec": {
        "application": "pose-point-cloud-recording",
        "parameters": {"vehicles": ["vehicle-00", "vehicle-01"]},
        "reason": "a ROS node of vehicle-00 asks",
    },
}

# Says one text on /robotkube/tasks and prints the answers, until one of them holds the word.
ASK = """
import sys, time
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.ros.core.common_messages import string_message, string_text
text, word, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
node, kind, end = RosNode("asker"), "std_msgs/msg/String", time.monotonic() + float(seconds)
tasks, answers = node.advertise("/robotkube/tasks", kind, depth=100), node.subscribe("/robotkube/task_status", kind)
while not (tasks.matched and answers.matched) and time.monotonic() < end:
    time.sleep(0.05)
tasks.publish(string_message(text.encode()))
while time.monotonic() < end:
    for data in answers.take():
        line = string_text(data).decode()
        print(line, flush=True)
        if word in line:
            sys.exit(0)
    time.sleep(0.02)
sys.exit("no answer with " + word)
"""


def ask(stage: Stage, text: str, word: str) -> list[dict[str, Any]]:
    """What a ROS node of its own in the bridge's pod (nobody starts a pod of a vehicle by hand) hears up to an answer
    that holds `word`; fails when none does."""
    seconds = ANSWER_SECONDS_MAX
    return [json.loads(line) for line in stage.run(BRIDGE, ASK, text, word, str(seconds), seconds=seconds + 30)]


@pytest.fixture
def open_gateway(platform: Platform, stage: Stage) -> Iterator[None]:
    """The vehicle's bridge carries the topics of the task gateway."""
    with stage.asked_by_a_person({"application": "task-door", "agents": [AGENT]}):
        eventually("the bridge has the topics", lambda: _carries(platform), DEPLOYED_SECONDS_MAX)
        yield


def _carries(platform: Platform) -> bool:
    return "/robotkube/tasks" in platform.get("-n", AGENT, "configmap", "mqtt-bridge")["data"]["config.yaml"]


@pytest.mark.usefixtures("open_gateway")
def test_a_ros_node_on_a_vehicle_asks_hears_and_withdraws(stage: Stage) -> None:
    key = f"{AGENT}/asked-by-ros"
    stage.submitted.append(key)
    answers = ask(stage, json.dumps(TASK), '"status": "True", "type": "Ready"')
    assert {answer["id"] for answer in answers} == {"asked-by-ros"}
    task = stage.tasks(AGENT)[key]
    assert (task["spec"]["requester"], task["spec"]["event"]["rule"]) == (AGENT, "asked")
    stage.await_running(RECORDER)
    assert key in stage.annotation(RECORDER, "tasks").split()
    [*_, last] = ask(stage, '{"withdraw": "asked-by-ros"}', '"withdrawn": true')
    assert last == {"id": "asked-by-ros", "conditions": [], "withdrawn": True}
    stage.await_gone(RECORDER)
