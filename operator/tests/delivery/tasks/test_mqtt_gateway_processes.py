"""The MQTT gateway between a real broker and a real API server: at least once, one task per id, and answers."""

from __future__ import annotations

import functools
import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.measuring import pods
from robotkube.delivery.manager.adapters.kubernetes_cluster import KubernetesCluster
from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.delivery.tasks.adapters.paho_gateway import UNACKNOWLEDGED_MAX, PahoGateway
from robotkube.delivery.tasks.core.mqtt_messages import GATEWAY_REASONS
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway
from robotkube.foundation.kubernetes.adapters.client import api_client, call
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from tests.stages.delivery.tasks.random_messages import random_message
from tests.stages.kubernetes.api_calls import TASKS, Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

SPEC = {"application": "recording", "parameters": {"vehicles": ["vehicle-00"]}}
ANSWER_SECONDS_MAX = 20.0
RANDOM_MESSAGES, THOROUGH_MESSAGES = 200, 1000
AHEAD_MAX = 100  # messages that the operator is ahead of the gateway: the broker keeps 128 MiB, and some have 10 MiB
MORE_THAN_UNDER_WAY = 2 * UNACKNOWLEDGED_MAX


class Operator:
    """cloud-0 at the broker: what it sent was accepted by the broker; what it heard."""

    def __init__(self, port: int) -> None:
        self.heard: list[dict[str, Any]] = []
        self._subscribed = threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "operator", protocol=mqtt.MQTTv5)
        self._client.username_pw_set("cloud-0", pods.password("cloud-0"))
        self._client.on_connect = lambda *_: self._client.subscribe("robotkube/task_status/cloud-0", 1)
        self._client.on_subscribe = lambda *_: self._subscribed.set()
        self._client.on_message = lambda _c, _u, message: self.heard.append(json.loads(message.payload))
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert self._subscribed.wait(ANSWER_SECONDS_MAX)

    def say(self, document: Any) -> None:
        payload = document if isinstance(document, bytes) else json.dumps(document).encode()
        self._client.publish("robotkube/tasks/cloud-0", payload, 1).wait_for_publish(ANSWER_SECONDS_MAX)

    def ask(self, name: str, **spec: Any) -> None:
        self.say({"metadata": {"name": name}, "spec": {**SPEC, **spec}})

    def answers(self, name: str | None) -> list[dict[str, Any]]:
        return [answer for answer in self.heard if answer["id"] == name]

    def refusal(self, name: str | None) -> str:
        until(lambda: self.answers(name), f"an answer about {name}", ANSWER_SECONDS_MAX)
        [condition] = self.answers(name)[-1]["conditions"]
        return f"{condition['reason']}: {condition['message']}"

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class RunningGateway:
    """The manager's side."""

    def __init__(self, api_server: ApiServerProcess, broker: pods.Broker) -> None:
        client = api_client(str(api_server.kubeconfig))
        self.cluster = KubernetesCluster(client, "argocd", lambda what: None, time.time)
        self.cluster.start()
        assert self.cluster.wait_until_synced(20)
        account = BrokerAccount("127.0.0.1", broker.port, "manager", pods.password("manager"))
        channel = PahoGateway(account, "manager-gateway")
        writer = KubernetesTasks(functools.partial(call, client))
        operators = {"cloud-0": "cloud-0"}
        self.loop = MqttTaskGateway(operators, channel, self.cluster, writer, self, time.time_ns, time.monotonic)
        self.loop.start()
        until(lambda: not channel.complaint, "the gateway open")

    def term(self) -> int | None:
        return 1

    def overtake(self, term: int) -> None:
        raise AssertionError("nobody asks the gateway")

    def close(self) -> None:
        self.loop.stop(5.0)
        self.cluster.stop()


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pods.Broker]:
    rules = {
        "manager": ["topic read robotkube/tasks/#", "topic write robotkube/task_status/#"],
        "cloud-0": ["topic write robotkube/tasks/cloud-0", "topic read robotkube/task_status/cloud-0"],
    }
    started = pods.Broker(tmp_path_factory.mktemp("broker") / "files", rules)
    started.start()
    yield started
    started.stop()


@pytest.fixture
def operator(broker: pods.Broker) -> Iterator[Operator]:
    connected = Operator(broker.port)
    yield connected
    connected.close()


@pytest.fixture
def gateway(api_server: ApiServerProcess, broker: pods.Broker) -> Iterator[RunningGateway]:
    started = RunningGateway(api_server, broker)
    yield started
    started.close()


def task(api: Api, name: str) -> dict[str, Any] | None:
    try:
        return dict(json.loads(call(api.client, "GET", f"{TASKS}/{name}").data))
    except KeyError:
        return None


def present(api: Api, name: str) -> dict[str, Any]:
    until(lambda: task(api, name), f"task {name}")
    read = task(api, name)
    assert read is not None
    return read


def test_asking_changing_renewing_and_withdrawing(api: Api, operator: Operator, gateway: RunningGateway) -> None:
    operator.ask("gateway-one")
    made = present(api, "gateway-one")
    assert (made["spec"]["requester"], made["spec"]["event"]["rule"]) == ("cloud-0", "asked")
    operator.ask("gateway-one")
    operator.ask("gateway-one", parameters={"vehicles": ["vehicle-01"]}, requester="somebody")
    until(lambda: present(api, "gateway-one")["spec"]["parameters"] == {"vehicles": ["vehicle-01"]}, "the change")
    changed = present(api, "gateway-one")
    assert (changed["metadata"]["uid"], changed["metadata"]["generation"]) == (made["metadata"]["uid"], 2)
    assert changed["spec"]["event"] == made["spec"]["event"]
    operator.say({"renew": "gateway-one"})
    renewed = "robotkube.io/lease-renewed"
    until(lambda: renewed in present(api, "gateway-one")["metadata"].get("annotations", {}), "renewed")
    assert present(api, "gateway-one")["metadata"]["generation"] == 2
    condition = {"type": "Accepted", "status": "True", "reason": "Accepted", "message": "yes"}
    status = {"conditions": [{**condition, "lastTransitionTime": "2026-11-21T10:00:00Z"}], "plan": "p-1"}
    gateway.cluster.patch_status("cloud-0", "gateway-one", status)
    until(lambda: any(answer.get("plan") == "p-1" for answer in operator.answers("gateway-one")), "the status answered")
    operator.say({"withdraw": "gateway-one"})
    until(lambda: {"id": "gateway-one", "conditions": [], "withdrawn": True} in operator.heard, "the end answered")
    assert task(api, "gateway-one") is None


def test_the_api_servers_refusal_is_answered(api: Api, operator: Operator, gateway: RunningGateway) -> None:
    operator.ask("gateway-typo", aplication="x")
    assert "aplication" in operator.refusal("gateway-typo")
    operator.ask("gateway-priority", priority="high")
    assert operator.refusal("gateway-priority").startswith("NotAccepted: ")
    operator.say(b"\xff not JSON")
    assert operator.refusal(None).startswith("NotReadable: ")
    operator.heard.clear()
    operator.say(b"[" + b" " * (10 * 1024 * 1024))
    assert operator.refusal(None).startswith("TooLarge: ")
    assert [task(api, name) for name in ("gateway-typo", "gateway-priority")] == [None, None]


@pytest.mark.parametrize("count", [RANDOM_MESSAGES, pytest.param(THOROUGH_MESSAGES, marks=pytest.mark.thorough)])
def test_random_messages_become_tasks_or_are_answered(
    api: Api, operator: Operator, gateway: RunningGateway, count: int
) -> None:
    before = resident_bytes()
    outcomes = gateway.loop.statistics.outcomes
    for number in range(count):
        until(lambda enough=number - AHEAD_MAX: sum(outcomes.values()) >= enough, "the gateway", ANSWER_SECONDS_MAX)
        operator.say(random_message(number))
    until(lambda: sum(outcomes.values()) >= count, "every message handled", ANSWER_SECONDS_MAX + count / 2)
    refused = sum(outcomes[reason] for reason in GATEWAY_REASONS)
    until(lambda: len([a for a in operator.heard if refusal_of(a)]) == refused, "every refusal answered")
    assert {refusal_of(answer) for answer in operator.heard} - {""} <= set(GATEWAY_REASONS)
    assert (outcomes["created"] > 0, outcomes["TooLarge"] > 0, outcomes["NotReached"]) == (True, True, 0)
    assert resident_bytes() - before < 192 * 1024 * 1024  # client and gateway are one process here


def refusal_of(answer: dict[str, Any]) -> str:
    reasons = [condition["reason"] for condition in answer["conditions"] if condition["status"] == "False"]
    return reasons[0] if reasons else ""


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_what_was_said_while_the_gateway_was_closed_is_heard_later(
    api: Api, api_server: ApiServerProcess, broker: pods.Broker, operator: Operator
) -> None:
    RunningGateway(api_server, broker).close()
    operator.ask("gateway-later")
    assert task(api, "gateway-later") is None
    again = RunningGateway(api_server, broker)
    assert present(api, "gateway-later")
    again.close()


def test_what_was_refused_before_the_gateway_had_subscribed_is_answered(
    api_server: ApiServerProcess, broker: pods.Broker, operator: Operator
) -> None:
    RunningGateway(api_server, broker).close()
    for number in range(MORE_THAN_UNDER_WAY):
        operator.say(f"not JSON {number}".encode())
    again = RunningGateway(api_server, broker)  # the broker sends what it kept before it answers the subscription
    until(lambda: len(operator.answers(None)) == MORE_THAN_UNDER_WAY, "every answer", ANSWER_SECONDS_MAX)
    again.close()


def test_a_broker_that_is_away_is_found_again(api: Api, api_server: ApiServerProcess, broker: pods.Broker) -> None:
    gateway = RunningGateway(api_server, broker)
    broker.stop()
    until(lambda: gateway.loop.complaint, "the loss noticed")
    broker.start()
    until(lambda: not gateway.loop.complaint, "the gateway open again")
    operator = Operator(broker.port)
    operator.ask("gateway-again")
    assert present(api, "gateway-again")
    operator.close()
    gateway.close()


def test_an_api_server_that_is_away_delays_and_loses_nothing(
    api: Api, api_server: ApiServerProcess, operator: Operator, gateway: RunningGateway
) -> None:
    api_server.stop_server()
    for index in range(3):
        operator.ask(f"gateway-away-{index}")
    api_server.start_server()
    for index in range(3):
        assert present(api, f"gateway-away-{index}")
