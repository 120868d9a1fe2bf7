"""A ROS process asks for a task: over ROS to the real bridge of its node, over mosquitto to the gateway, and back."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.measuring import pods
from robotkube.delivery.tasks.adapters import paho_gateway
from robotkube.delivery.tasks.adapters.paho_gateway import PahoGateway
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.testing.clusters import MemoryTasks
from robotkube.testing.task_gateways import MemoryTaskWriter
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

AGENT = "vehicle-00"
TASK = {"metadata": {"name": "look"}, "spec": {"application": "recording", "parameters": {"vehicles": [AGENT]}}}
STRING = "std_msgs/msg/String"

# Asks once the bridge is there, withdraws at the first answer, and prints all answers until the last.
ASKER = """
import sys, time
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.ros.core.common_messages import string_message, string_text
node, end, said = RosNode("asker"), time.monotonic() + 25, 0
out, into = node.advertise("/robotkube/tasks", "std_msgs/msg/String"), node.subscribe(
    "/robotkube/task_status", "std_msgs/msg/String")
while time.monotonic() < end:
    if not said and out.matched and into.matched:
        said = out.publish(string_message(sys.argv[1].encode())) or 1
    for data in into.take():
        line = string_text(data).decode()
        print(line, flush=True)
        if "withdrawn" in line:
            sys.exit(0)
        out.publish(string_message(b'{"withdraw": "look"}'))
    time.sleep(0.02)
sys.exit("no last answer")
"""


class Leading:
    """This process has the gateway."""

    def term(self) -> int | None:
        return 1

    def overtake(self, term: int) -> None:
        raise AssertionError("nobody asks the gateway")


@pytest.fixture
def nodes() -> Iterator[pods.Nodes]:
    namespaces = pods.Nodes()
    yield namespaces
    namespaces.close()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    rules = {
        "manager": ["topic read robotkube/tasks/#", "topic write robotkube/task_status/#"],
        AGENT: [f"topic write robotkube/tasks/{AGENT}", f"topic read robotkube/task_status/{AGENT}"],
    }
    started = pods.Broker(tmp_path / "broker", rules)
    started.start()
    yield started
    started.stop()


def account(broker: pods.Broker) -> BrokerAccount:
    return BrokerAccount("127.0.0.1", broker.port, "manager", pods.password("manager"))


@pytest.fixture
def tasks(broker: pods.Broker) -> Iterator[MemoryTasks]:
    """What the gateway writes."""
    memory = MemoryTasks()
    channel = PahoGateway(account(broker), "manager-task-door")
    writer = MemoryTaskWriter(memory)
    gateway = MqttTaskGateway({AGENT: AGENT}, channel, memory, writer, Leading(), time.time_ns, time.monotonic)
    gateway.start()
    until(lambda: gateway.is_open, "the gateway open")
    yield memory
    gateway.stop(5.0)


@contextlib.contextmanager
def running(broker: pods.Broker, name: str, messages: int) -> Iterator[PahoGateway]:
    """A gateway with a session of its own, to which an operator has sent 0, 1, 2 and so on."""
    gateway = PahoGateway(account(broker), name)
    gateway.start([f"robotkube/tasks/{AGENT}"])
    until(lambda: not gateway.complaint, "the gateway open")
    operator = mqtt.Client(CallbackAPIVersion.VERSION2, "operator", protocol=mqtt.MQTTv5)
    operator.username_pw_set(AGENT, pods.password(AGENT))
    operator.connect("127.0.0.1", broker.port)
    operator.loop_start()
    sent = [operator.publish(f"robotkube/tasks/{AGENT}", str(number), 1) for number in range(messages)]
    for one in sent:
        one.wait_for_publish(10)
    yield gateway
    operator.disconnect()
    operator.loop_stop()
    gateway.close()


def test_a_broker_that_sends_more_than_is_kept_loses_nothing(
    broker: pods.Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paho_gateway, "WAITING_MAX", 5)
    monkeypatch.setattr(paho_gateway, "UNACKNOWLEDGED_MAX", 100)
    heard: list[int] = []
    with running(broker, "manager-overrun", 20) as gateway:
        until(lambda: gateway._overrun, "more than is kept")
        until(lambda: receive_all(gateway, heard) == 20, "all messages")
    assert list(dict.fromkeys(heard)) == list(range(20))


def test_what_is_left_comes_again_before_what_was_behind_it(
    broker: pods.Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard, kept = list[int](), list[int]()
    with running(broker, "manager-leaving", 200) as gateway:
        while len(heard) < 3:
            message = gateway.receive(1.0)
            assert message is not None
            heard.append(int(message.payload))
            if heard == [0, 1, 2]:
                monkeypatch.setattr(gateway, "_shut", arriving(gateway, kept, gateway._shut))
            (gateway.acknowledge if heard != [0, 1, 2] else gateway.leave)(message)
        assert kept == [0], "what was on its way is not kept"
        until(lambda: receive_all(gateway, heard) == 200, "all messages")
    again = heard[3]  # what was acknowledged just before may come once more
    assert again <= 2
    assert heard[3:] == list(range(again, 200))


def arriving(gateway: PahoGateway, kept: list[int], shut: Callable[[], None]) -> Callable[[], None]:
    """Ends the connection as `shut` does, after paho has delivered one more message of it; `kept`: of how many."""

    def after_one() -> None:
        waiting = gateway._waiting.qsize()
        gateway._received(None, None, mqtt.MQTTMessage())
        kept.append(gateway._waiting.qsize() - waiting)
        shut()

    return after_one


def receive_all(gateway: PahoGateway, heard: list[int]) -> int:
    """Receive and acknowledge what is here; how many different messages were heard so far."""
    while (message := gateway.receive(0.01)) is not None:
        heard.append(int(message.payload))
        gateway.acknowledge(message)
    return len(set(heard))


def test_a_ros_process_asks_hears_and_withdraws(
    nodes: pods.Nodes, broker: pods.Broker, tasks: MemoryTasks, tmp_path: Path
) -> None:
    node = nodes.node()
    settings = {
        "agent": AGENT,
        "out": [{"name": "/robotkube/tasks", "type": STRING, "depth": 100}],
        "in": [{"name": "/robotkube/task_status", "type": STRING, "depth": 100}],
    }
    (tmp_path / "config.yaml").write_text(json.dumps(settings))
    secrets = broker.secret(AGENT, nodes.gateway(node))
    environment = {"ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml"), "ROBOTKUBE_SECRETS": str(secrets)}
    command = pods.python("robotkube.robots.bridge")
    bridge = pods.start("bridge", command, environment, tmp_path / "bridge.log", nodes.pod(node))
    command = [pods.python("x")[0], "-c", ASKER, json.dumps(TASK)]
    asker = pods.start("asker", command, {}, tmp_path / "asker.log", nodes.pod(node))
    try:
        until(lambda: asker.process.poll() is not None, "the asker's end")
    finally:
        asker.stop()
        bridge.stop()
    log = (tmp_path / "asker.log").read_text()
    assert asker.process.returncode == 0, f"{log}\n{(tmp_path / 'bridge.log').read_text()}"
    answers = [json.loads(line) for line in log.splitlines()]
    assert answers[0] == {"id": "look", "conditions": []}
    assert answers[-1] == {"id": "look", "conditions": [], "withdrawn": True}
    assert tasks.objects == {}
