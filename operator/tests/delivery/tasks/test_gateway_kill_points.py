"""A manager that is killed at any write of its task gateway: started again, it has done every order once.

The points are generated from the writes that the adapters declare: a new one is tried without being named here.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.measuring import pods
from robotkube.delivery.tasks.adapters import kubernetes_tasks, paho_gateway
from robotkube.writes import WRITES
from tests.stages.delivery.manager.manager_process import Outside, Pod, write_settings
from tests.stages.kubernetes.api_calls import TASKS, Api
from tests.stages.programs import free_port
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

OPERATOR = "cloud-0"
ANSWER_SECONDS_MAX = 20.0
NOWHERE = "http://127.0.0.1:1"
SPEC = {"application": "recording", "parameters": {"vehicles": ["vehicle-00"]}}
CHANGED = {"application": "recording", "parameters": {"vehicles": ["vehicle-01"]}}
ORDERS = (
    {"metadata": {"name": "stays"}, "spec": SPEC},
    {"metadata": {"name": "goes"}, "spec": SPEC},
    {"metadata": {"name": "stays"}, "spec": CHANGED},
    {"renew": "stays"},
    {"withdraw": "goes"},
    "nothing that could become a task",
)
GATEWAY = (kubernetes_tasks.__name__, paho_gateway.__name__)
POINTS = [f"kill {when} {name}" for name in sorted(WRITES) if name.startswith(GATEWAY) for when in ("before", "after")]
QUICK = f"kill after {kubernetes_tasks.__name__}.KubernetesTasks.create"


class Operator:
    """What the operator heard; it says its orders once, and the broker has them then."""

    def __init__(self, port: int) -> None:
        self.heard: list[dict[str, Any]] = []
        subscribed = threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "operator", protocol=mqtt.MQTTv5)
        self._client.username_pw_set(OPERATOR, pods.password(OPERATOR))
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.on_message = lambda _c, _u, message: self.heard.append(json.loads(message.payload))
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe(f"robotkube/task_status/{OPERATOR}", 1)
        assert subscribed.wait(ANSWER_SECONDS_MAX)

    def say(self, order: Any) -> None:
        self._client.publish(f"robotkube/tasks/{OPERATOR}", json.dumps(order), 1).wait_for_publish(ANSWER_SECONDS_MAX)

    def refused(self) -> list[str]:
        refusals = [answer["conditions"] for answer in self.heard if answer["id"] is None]
        return [condition["reason"] for [condition] in refusals]

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Managers:
    """Processes of one manager whose forge is away: the gateway does not need it."""

    def __init__(self, manager_api: Api, broker: pods.Broker, folder: Path) -> None:
        self._api, self._broker, self._folder = manager_api, broker, folder
        self.pods: list[Pod] = []

    def start(self, point: str = "") -> Pod:
        folder = self._folder / f"pod-{len(self.pods)}"
        port = free_port()
        (folder / "keys").mkdir(parents=True)
        account = self._broker.secret("manager", "127.0.0.1") / "broker"
        outside = Outside(NOWHERE, "x", "s", folder / "keys", "oci://127.0.0.1:1/verified", NOWHERE)
        broker = {"host": "127.0.0.1", "port": self._broker.port, "credentials": str(account)}
        config = write_settings(outside, folder, port, self._api.lease(), broker=broker)
        self.pods.append(Pod(config, self._api.kubeconfig, port, folder.name, point))
        return self.pods[-1]

    def is_open(self) -> bool:
        answer = self.pods[-1].get("/metrics")
        return answer is not None and "robotkube_task_gateway_connected 1.0\n" in answer.text


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    rules = {
        "manager": ["topic read robotkube/tasks/#", "topic write robotkube/task_status/#"],
        OPERATOR: [f"topic write robotkube/tasks/{OPERATOR}", f"topic read robotkube/task_status/{OPERATOR}"],
    }
    started = pods.Broker(tmp_path / "broker", rules)
    started.start()
    yield started
    started.stop()


@pytest.fixture
def operator(broker: pods.Broker) -> Iterator[Operator]:
    connected = Operator(broker.port)
    yield connected
    connected.close()


@pytest.fixture
def managers(manager_api: Api, broker: pods.Broker, tmp_path: Path) -> Iterator[Managers]:
    started = Managers(manager_api, broker, tmp_path)
    yield started
    for pod in started.pods:
        pod.kill()
    for item in manager_api.get(TASKS)["items"]:
        manager_api.delete(f"{TASKS}/{item['metadata']['name']}")


def test_every_kind_of_write_of_the_gateway_is_a_point() -> None:
    assert {WRITES[point.split(" ")[2]] for point in POINTS} == {"task", "message"}
    assert QUICK in POINTS


@pytest.mark.parametrize("point", [pytest.param(p, marks=() if p == QUICK else pytest.mark.thorough) for p in POINTS])
def test_orders_are_carried_out_once_whatever_write_the_manager_dies_at(
    manager_api: Api, managers: Managers, operator: Operator, point: str
) -> None:
    first = managers.start(point)
    until(managers.is_open, "the gateway open")
    for order in ORDERS:
        operator.say(order)
    until(lambda: first.process.poll() is not None, "the first process is dead")
    assert first.hit
    managers.start()
    until(lambda: "NotReadable" in operator.refused(), "the last order answered")
    [task] = manager_api.get(TASKS)["items"]
    assert (task["metadata"]["name"], task["metadata"]["generation"]) == ("stays", 2)
    assert (task["spec"]["parameters"], task["spec"]["requester"]) == (CHANGED["parameters"], OPERATOR)
    assert "robotkube.io/lease-renewed" in task["metadata"]["annotations"]
    assert set(operator.refused()) == {"NotReadable"}
