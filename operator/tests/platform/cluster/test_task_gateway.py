"""The task gateway on the whole platform: a ROS pod on a vehicle's node asks, hears, and takes it back. What cannot
become a task: delivery/tasks/test_mqtt_gateway_processes.py."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from tests.stages.platform.running_platform import Platform, eventually
from tests.stages.platform.table_one import DEPLOYED_SECONDS_MAX, Stage

AGENT, POD = "vehicle-00", "asker"
RECORDER = "cloud-0/recorder-vehicle-00-vehicle-01"
POD_SECONDS_MAX = 60.0
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


def pod(platform: Platform) -> dict[str, Any]:
    """A pod with the robots' image on the vehicle's node, as restricted as all others; it has no token."""
    [container] = platform.deployment(AGENT, "mqtt-bridge")["spec"]["template"]["spec"]["containers"]
    security = {"runAsNonRoot": True, "runAsUser": 10001, "seccompProfile": {"type": "RuntimeDefault"}}
    container = {
        "name": POD,
        "image": container["image"],
        "command": ["python3", "-c", "import time; time.sleep(1800)"],
        "env": [{"name": "HOME", "value": "/tmp"}, {"name": "ROS_LOG_DIR", "value": "/tmp/ros"}],  # noqa: S108
        "resources": {"requests": {"cpu": "10m", "memory": "32Mi"}, "limits": {"memory": "256Mi"}},
        "securityContext": {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}},
        "volumeMounts": [{"name": "tmp", "mountPath": "/tmp"}],  # noqa: S108
    }
    spec = {
        "nodeSelector": {"robotkube.io/agent": AGENT},
        "automountServiceAccountToken": False,
        "terminationGracePeriodSeconds": 1,
        "securityContext": security,
        "containers": [container],
        "volumes": [{"name": "tmp", "emptyDir": {"sizeLimit": "16Mi"}}],
    }
    return {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": POD, "namespace": AGENT}, "spec": spec}


class Asker:
    """The ROS pod."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform

    def running(self) -> bool:
        return bool(self._platform.get("-n", AGENT, "pod", POD)["status"].get("phase") == "Running")

    def say(self, text: str, word: str) -> list[dict[str, Any]]:
        """The answers up to one that holds `word`; fails when none does."""
        platform = self._platform
        kubectl = [str(platform.installer.binaries / "kubectl"), f"--kubeconfig={platform.access.kubeconfig}"]
        words = ["-n", AGENT, "exec", POD, "--", "python3", "-c", ASK, text, word, str(ANSWER_SECONDS_MAX)]
        limit = ANSWER_SECONDS_MAX + 30
        done = subprocess.run([*kubectl, *words], capture_output=True, text=True, timeout=limit, check=False)
        assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture
def asker(platform: Platform, stage: Stage) -> Iterator[Asker]:
    """The pod, while the vehicle's bridge carries the topics of the task door."""
    with stage.asked_by_a_person({"application": "task-door", "agents": [AGENT]}):
        platform.kubectl("apply", "-f", "-", text=json.dumps(pod(platform)))
        try:
            found = Asker(platform)
            eventually("the ROS pod runs", found.running, POD_SECONDS_MAX)
            eventually("the bridge has the topics", lambda: _carries(platform), DEPLOYED_SECONDS_MAX)
            yield found
        finally:
            platform.kubectl("-n", AGENT, "delete", "pod", POD, "--ignore-not-found", "--wait=true")


def _carries(platform: Platform) -> bool:
    return "/robotkube/tasks" in platform.get("-n", AGENT, "configmap", "mqtt-bridge")["data"]["config.yaml"]


def test_a_ros_pod_on_a_vehicle_asks_hears_and_withdraws(stage: Stage, asker: Asker) -> None:
    key = f"{AGENT}/asked-by-ros"
    stage.submitted.append(key)
    answers = asker.say(json.dumps(TASK), '"status": "True", "type": "Ready"')
    assert {answer["id"] for answer in answers} == {"asked-by-ros"}
    task = stage.tasks(AGENT)[key]
    assert (task["spec"]["requester"], task["spec"]["event"]["rule"]) == (AGENT, "asked")
    stage.await_running(RECORDER)
    assert key in stage.annotation(RECORDER, "tasks").split()
    [*_, last] = asker.say('{"withdraw": "asked-by-ros"}', '"withdrawn": true')
    assert last == {"id": "asked-by-ros", "conditions": [], "withdrawn": True}
    stage.await_gone(RECORDER)
