"""The MQTT gateway in memory: messages of operators become tasks, and statuses of tasks become answers."""

from __future__ import annotations

import json
import tracemalloc
from typing import Any

import pytest
from hypothesis import given

from robotkube.delivery.tasks.core.holds import DeviceHold, message_hold
from robotkube.delivery.tasks.core.mqtt_messages import (
    GATEWAY_REASONS,
    MESSAGE_BYTES_MAX,
    NOT_ACCEPTED,
    NOT_REACHED,
    NOT_READABLE,
    TOO_LARGE,
    UNKNOWN_TASK,
    LeaseRenewal,
    RejectedMessage,
    TaskRequest,
    TaskWithdrawal,
    read_message,
)
from robotkube.delivery.tasks.loops import mqtt_gateway
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway, gateway_metrics
from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.runtime.adapters.prometheus_series import series_text
from robotkube.testing.clusters import MemoryTasks
from robotkube.testing.task_gateways import MemoryGatewayChannel, MemoryTaskWriter
from tests.stages.delivery.tasks.random_messages import ASKED, SPEC, random_message
from tests.stages.examples import EXAMPLES
from tests.stages.random_json import mistaken

START_NS = 1795250000_000000000
RANDOM_MESSAGES = max(EXAMPLES, 60)  # enough for every outcome
THOROUGH_MESSAGES = 5000


class Stage:
    """A gateway with its surroundings."""

    def __init__(self) -> None:
        self.tasks = MemoryTasks()
        self.channel = MemoryGatewayChannel()
        self.writer = MemoryTaskWriter(self.tasks)
        self.seconds = 0.0
        self.leads = True
        operators = {"vehicle-00": "vehicle-00", "cloud-0": "cloud-0"}
        self.gateway = MqttTaskGateway(
            operators, self.channel, self.tasks, self.writer, self, lambda: START_NS + int(self.seconds * 1e9), self.now
        )

    def term(self) -> int | None:
        return 1 if self.leads else None

    def overtake(self, term: int) -> None:
        raise AssertionError("nobody asks the gateway")

    def now(self) -> float:
        return self.seconds

    def say(self, document: Any, operator: str = "vehicle-00") -> None:
        self.channel.send(operator, document)
        self.turn()

    def turn(self) -> None:
        self.seconds += 1.0
        self.gateway.turn(0.0)

    def new_answers(self) -> list[tuple[str, dict[str, Any]]]:
        answers = self.channel.answers
        self.channel.answers = []
        return answers

    def refusal(self) -> tuple[str, str]:
        [(topic, answer)] = self.new_answers()
        assert topic == "robotkube/task_status/vehicle-00"
        [condition] = answer["conditions"]
        assert (condition["type"], condition["status"]) == ("Accepted", "False")
        return condition["reason"], condition["message"]


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_a_message_becomes_a_task_of_its_operator(stage: Stage) -> None:
    stage.say(ASKED | {"spec": {**SPEC, "requester": "somebody-else", "priority": 200}})
    task = stage.tasks.objects["vehicle-00/look"]
    assert task["spec"]["requester"] == "vehicle-00"
    assert task["spec"]["priority"] == 200
    assert task["spec"]["event"]["id"] == "look"
    assert task["metadata"]["labels"] == {"robotkube.io/door": "mqtt"}
    assert stage.new_answers() == [("robotkube/task_status/vehicle-00", {"id": "look", "conditions": []})]
    assert len(stage.channel.acknowledged) == 1


def test_the_same_id_twice_is_one_task_and_another_spec_a_change(stage: Stage) -> None:
    stage.say(ASKED)
    stage.say(ASKED)
    assert stage.tasks.objects["vehicle-00/look"]["metadata"]["generation"] == 1
    stage.say(ASKED | {"spec": {**SPEC, "parameters": {"vehicles": ["vehicle-02"]}}})
    task = stage.tasks.objects["vehicle-00/look"]
    assert (task["metadata"]["generation"], task["spec"]["parameters"]) == (2, {"vehicles": ["vehicle-02"]})
    assert list(stage.tasks.objects) == ["vehicle-00/look"]


def test_a_task_of_a_namespace_cannot_be_named_from_another(stage: Stage) -> None:
    stage.say({**ASKED, "metadata": {"name": "look", "namespace": "cloud-0"}})
    assert stage.refusal()[0] == NOT_READABLE
    stage.say({**ASKED, "metadata": {"name": "cloud-0/look"}})
    assert stage.refusal()[0] == NOT_READABLE
    stage.say(ASKED, "cloud-0")
    stage.new_answers()
    stage.say({"withdraw": "look"})
    assert stage.refusal() == (UNKNOWN_TASK, "there is no task vehicle-00/look")
    assert list(stage.tasks.objects) == ["cloud-0/look"]


def test_withdrawing_and_renewing(stage: Stage) -> None:
    stage.say(ASKED)
    stage.say({"renew": "look"})
    assert stage.tasks.objects["vehicle-00/look"]["metadata"]["annotations"] == {
        "robotkube.io/lease-renewed": "2026-11-21T08:33:22.000000Z"
    }
    stage.new_answers()
    stage.say({"withdraw": "look"})
    assert stage.tasks.objects == {}
    assert stage.new_answers() == [
        ("robotkube/task_status/vehicle-00", {"id": "look", "conditions": [], "withdrawn": True})
    ]
    stage.say({"renew": "look"})
    assert stage.refusal()[0] == UNKNOWN_TASK


def test_what_changes_in_a_status_is_answered_once_and_nothing_of_others_tasks(stage: Stage) -> None:
    stage.say(ASKED)
    stage.tasks.create("vehicle-00", "detected", SPEC)
    condition = {"type": "Accepted", "status": "True", "reason": "Accepted", "message": "yes"}
    status = {"conditions": [condition], "plan": "p", "pullRequest": {"number": 3, "url": "u"}, "unknown": 1}
    stage.new_answers()
    for name in ("look", "detected"):
        stage.tasks.patch_status("vehicle-00", name, status)
    stage.turn()
    stage.turn()
    [(_, answer)] = stage.new_answers()
    assert answer == {"id": "look", "conditions": [condition], "plan": "p", "pullRequest": {"number": 3, "url": "u"}}


def test_a_restarted_gateway_answers_again_and_forgets_nothing(stage: Stage) -> None:
    stage.say(ASKED)
    operators = {"vehicle-00": "vehicle-00"}
    again = MqttTaskGateway(operators, stage.channel, stage.tasks, stage.writer, stage, lambda: 0, lambda: 1.0)
    stage.new_answers()
    again.turn(0.0)
    assert [answer["id"] for _, answer in stage.new_answers()] == ["look"]


def test_answers_wait_for_the_broker_and_refused_messages_come_again(stage: Stage) -> None:
    stage.channel.connected = False
    stage.say(ASKED)
    stage.say(b"no JSON")
    assert [message.payload for message in stage.channel.acknowledged] == [json.dumps(ASKED).encode()]
    assert [message.payload for message in stage.channel.left] == [b"no JSON"]
    stage.channel.connected = True
    stage.turn()
    assert [answer["id"] for _, answer in stage.new_answers()] == ["look"]


def test_an_api_server_that_is_away_delays_and_one_that_refuses_is_quoted(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt_gateway, "RETRY_SECONDS_FIRST", 0.001)
    stage.writer.faults = [UnavailableError("away"), UnavailableError("away")]
    stage.say(ASKED)
    assert list(stage.tasks.objects) == ["vehicle-00/look"]
    stage.new_answers()
    stage.writer.faults = [InputError("spec.priority: must be at most 1000")]
    stage.say({**ASKED, "metadata": {"name": "second"}})
    assert stage.refusal() == (NOT_ACCEPTED, "spec.priority: must be at most 1000")


def test_trying_again_is_bounded(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_gateway, "RETRY_SECONDS_FIRST", 0.001)
    monkeypatch.setattr(mqtt_gateway, "TRY_SECONDS_MAX", -1.0)
    stage.writer.faults = [UnavailableError("away")]
    stage.say(ASKED)
    assert stage.refusal()[0] == NOT_REACHED


def test_a_gateway_that_closes_leaves_the_message_with_the_broker(stage: Stage) -> None:
    stage.gateway.stop(1.0)
    stage.say(ASKED)
    assert (stage.tasks.objects, stage.channel.acknowledged) == ({}, [])


def test_only_the_process_that_leads_has_the_gateway_open(stage: Stage) -> None:
    stage.turn()
    kinds = ("tasks", "holds")
    topics = [f"robotkube/{kind}/{name}" for kind in kinds for name in ("cloud-0", "vehicle-00")]
    assert stage.channel.topics == [*topics, "robotkube/links/cloud-0/+", "robotkube/links/vehicle-00/+"]
    stage.leads = False
    stage.say(ASKED)
    assert (stage.channel.connected, stage.tasks.objects, stage.gateway.complaint) == (False, {}, "")
    stage.leads = stage.channel.connected = True
    stage.turn()
    assert list(stage.tasks.objects) == ["vehicle-00/look"]


def test_topics_of_nobody_are_dropped(stage: Stage) -> None:
    stage.say(ASKED, "vehicle-99")
    assert (stage.tasks.objects, stage.new_answers(), len(stage.channel.acknowledged)) == ({}, [], 1)


@pytest.mark.parametrize(
    ("payload", "reason", "words"),
    [
        (b"", NOT_READABLE, "no JSON"),
        (b"\xff\xfe", NOT_READABLE, "UTF-8"),
        (b"[1]", NOT_READABLE, "list and no object"),
        (b"[" * 100_000, NOT_READABLE, "no JSON"),
        (b'{"metadata": {"name": "a"}, "metadata": {}, "spec": {}}', NOT_READABLE, "stands twice"),
        (b'{"metadata": {"name": "a"}, "spec": {"x": NaN}}', NOT_READABLE, "spec.x: nan is not a JSON number"),
        (b'{"metadata": {"name": "A b"}, "spec": {}}', NOT_READABLE, "metadata.name"),
        (b'{"metadata": {"name": "a"}, "spec": {}, "status": {}}', NOT_READABLE, "status: unknown key"),
        (b'{"metadata": {"name": "a"}, "spec": {"chain": {}}}', NOT_READABLE, "spec.chain: is set by the platform"),
        (b'{"kind": "Pod", "metadata": {"name": "a"}, "spec": {}}', NOT_READABLE, "kind: 'Pod' must be"),
        (b'{"withdraw": "a", "renew": "a"}', NOT_READABLE, "renew: unknown key"),
        (b'{"withdraw": 7}', NOT_READABLE, "withdraw: 7 must match"),
        (b'{"metadata": {"name": "a"}, "spec": "' + b"x" * MESSAGE_BYTES_MAX + b'"}', TOO_LARGE, "at most 262144"),
    ],
)
def test_what_cannot_become_a_task_is_refused_with_words(stage: Stage, payload: bytes, reason: str, words: str) -> None:
    stage.say(payload)
    refused, message = stage.refusal()
    assert refused == reason
    assert words in message
    assert len(message) < 3000
    assert stage.tasks.objects == {}


def test_a_refusal_names_the_id_where_it_can() -> None:
    assert read_message(b'{"metadata": {"name": "a"}, "spec": 1}', 10) == RejectedMessage(
        NOT_READABLE, "spec: must be an object", "a"
    )


@pytest.mark.parametrize("count", [RANDOM_MESSAGES, pytest.param(THOROUGH_MESSAGES, marks=pytest.mark.thorough)])
def test_random_messages_are_accepted_or_refused_with_a_reason_in_bounded_memory(stage: Stage, count: int) -> None:
    tracemalloc.start()
    outcomes: dict[str, int] = {}
    for number in range(count):
        payload = random_message(number)
        order = read_message(payload, len(payload))
        stage.say(payload)
        if isinstance(order, RejectedMessage):
            assert order.reason in GATEWAY_REASONS
            assert order.message
        expected = order.reason if isinstance(order, RejectedMessage) else type(order).__name__
        outcomes[expected] = outcomes.get(expected, 0) + 1
        if isinstance(order, TaskRequest):
            assert f"vehicle-00/{order.id}" in stage.tasks.objects
        stage.new_answers()
        [acknowledged] = stage.channel.acknowledged
        assert acknowledged.size == len(payload)
        stage.channel.acknowledged.clear()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert {"TaskRequest", NOT_READABLE, TOO_LARGE} <= set(outcomes)
    assert peak < 64 * 1024 * 1024
    assert 'outcome="TooLarge"' in series_text(gateway_metrics(stage.gateway))


@given(mistaken(ASKED) | mistaken({"withdraw": "look"}) | mistaken({"renew": "look"}))
def test_any_document_is_an_order_or_refused_with_words(document: Any) -> None:
    payload = json.dumps(document).encode()
    order = read_message(payload, len(payload))
    assert isinstance(order, (TaskRequest, TaskWithdrawal, LeaseRenewal, RejectedMessage))
    if isinstance(order, RejectedMessage):
        assert order.reason == NOT_READABLE
        assert order.message


@pytest.mark.parametrize("payload", [b"[" * 100_000, b"[" * 101 + b"]" * 101, b'{"spec":' * 10_000])
def test_a_deep_message_is_refused_with_words(payload: bytes) -> None:
    order = read_message(payload, len(payload))
    words = "no JSON in UTF-8: nested deeper than 100 levels; write it flatter; send one JSON object"
    assert order == RejectedMessage(NOT_READABLE, words)


@given(mistaken({"reason": "driving", "until": "2026-11-21T10:00:00Z"}))
def test_any_document_is_a_hold_or_refused_with_words(document: Any) -> None:
    try:
        held: DeviceHold | tuple[str, ...] | None = message_hold("vehicle-00", json.dumps(document).encode(), START_NS)
    except DocumentError as error:
        held = error.problems
    assert held
