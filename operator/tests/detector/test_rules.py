"""Rules besides proximity, leases and chains: thresholds on numbers, rules that always hold, tasks that are renewed."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from waiting import until

from robotkube.domain.demands import time_text
from robotkube.domain.detection import START, STOP, Threshold
from robotkube.domain.detector_settings import DetectorSettings, ThresholdRule, TopicSettings, read_detector_settings
from robotkube.domain.errors import DocumentError, UnavailableError
from robotkube.domain.message_fields import LAYOUTS, number_fields, number_in
from robotkube.domain.topics import TopicPattern
from robotkube.services.event_detector import EventDetector
from robotkube.services.operator_reactions import OperatorReactions
from scenarios.generator.messages import store

NOW = 1_795_250_000_000_000_000
TOPIC = "/vehicles/vehicle_00/uncertainty"
DOCUMENT: dict[str, Any] = {
    "name": "vehicle-00/uncertainty-operator",
    "task": "cloud-0/approach-1",
    "topics": [{"name": TOPIC, "type": "std_msgs/msg/Float64"}],
    "rules": [
        {
            "name": "uncertain",
            "kind": "threshold",
            "topic": TOPIC,
            "field": "data",
            "start_above": 0.15,
            "stop_below": 0.1,
        }
    ],
    "reactions": [
        {
            "rule": "uncertain",
            "kind": "operator",
            "application": "environment-perception",
            "parameters": {"sensor": "roadside-0"},
            "lease_seconds": 30,
        }
    ],
}
ALWAYS = {
    **DOCUMENT,
    "rules": [{"name": "near", "kind": "always"}],
    "reactions": [{**DOCUMENT["reactions"][0], "rule": "near"}],
}


def number(value: float) -> bytes:
    return b"\0\1\0\0" + struct.pack("<d", value)


class Topic:
    lost = 0

    def __init__(self) -> None:
        self.waiting: list[tuple[bytes, int]] = []

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        taken, self.waiting = self.waiting, []
        return taken

    def close(self) -> None: ...


class Topics:
    def __init__(self) -> None:
        self.topics: dict[str, Topic] = {}

    def subscribe(self, topic: str, settings: TopicSettings) -> Topic:
        return self.topics.setdefault(topic, Topic())

    def visible(self) -> Mapping[str, Sequence[str]]:
        return {}


class Tasks:
    """Tasks by name, and when each was renewed; `away` makes renewals fail that many times."""

    def __init__(self) -> None:
        self.objects: dict[str, Any] = {}
        self.renewals: list[tuple[str, int]] = []
        self.away = 0

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        return list(self.objects.values())

    def create(self, task: Mapping[str, Any]) -> None:
        self.objects.setdefault(task["metadata"]["name"], task)

    def renew(self, name: str, now: int) -> bool:
        if self.away:
            self.away -= 1
            raise UnavailableError("API server: away")
        self.renewals.append((name, now))
        return name in self.objects

    def delete(self, name: str) -> None:
        self.objects.pop(name, None)


class Stage:
    """A detector with its surroundings; `seconds` is the monotonic time of its leases."""

    def __init__(self, tasks: Tasks) -> None:
        self.live, self.tasks, self.now, self.seconds = Topics(), tasks, NOW, 0.0
        self.operators: list[OperatorReactions] = []
        self.detector = EventDetector(
            self.live, self.operator, lambda *_: pytest.fail("nothing to record"), lambda: self.now, time.monotonic
        )

    def operator(self, settings: DetectorSettings) -> OperatorReactions:
        found = OperatorReactions(
            settings.name, settings.agent, self.tasks, lambda: self.now, lambda: self.seconds, settings.task
        )
        self.operators.append(found)
        found.start()
        return found

    def apply(self, document: Mapping[str, Any]) -> None:
        self.detector.apply(read_detector_settings(document, "config.yaml"))
        until(lambda: all(operator.adopted is not None for operator in self.operators))
        self.detector.turn()

    def send(self, *values: float) -> None:
        for value in values:
            self.now += 1000
            self.live.topics[TOPIC].waiting.append((number(value), self.now))
        self.detector.turn()

    def done(self) -> list[str]:
        """Edges whose reaction the API server has acknowledged."""
        events = self.detector.events_document()["events"]
        until(lambda: all(event["done"] for event in self.detector.events_document()["events"]))
        return [event["edge"] for event in events]


@pytest.fixture
def make_stage() -> Iterator[Callable[[Tasks], Stage]]:
    stages: list[Stage] = []

    def make(tasks: Tasks) -> Stage:
        stages.append(Stage(tasks))
        return stages[-1]

    yield make
    for stage in stages:
        for operator in stage.operators:
            operator.stop(5.0)


@pytest.fixture
def stage(make_stage: Callable[[Tasks], Stage]) -> Stage:
    return make_stage(Tasks())


@pytest.mark.parametrize(
    ("above", "values", "edges"),
    [
        (True, [0.1, 0.15, 0.16, 0.12, 0.1, 0.09, 0.12, 0.2], [(2, START), (5, STOP), (7, START)]),
        (False, [0.2, 0.15, 0.14, 0.19, 0.2, 0.21, 0.16, 0.1], [(2, START), (5, STOP), (7, START)]),
    ],
)
def test_a_threshold_has_a_start_and_a_stop(above: bool, values: list[float], edges: list[tuple[int, str]]) -> None:
    rule = ThresholdRule("r", TopicPattern("/x"), "data", above, 0.15, 0.1 if above else 0.2)
    state = Threshold(rule, "std_msgs/msg/Float64")
    found = [(n, edge) for n, value in enumerate(values) for edge in state.evaluate("a", number(value), n, n)]
    assert [(n, edge.edge) for n, edge in found] == edges
    assert found[0][1].id == found[1][1].id != found[2][1].id


def test_agents_of_a_pattern_have_events_of_their_own() -> None:
    state = Threshold(ThresholdRule("r", TopicPattern("/v/{agent}/x"), "data", True, 1, 1), "std_msgs/msg/Float64")
    edges = [edge for agent in ("a", "b") for edge in state.evaluate(agent, number(2), 1, 1)]
    assert [edge.agents for edge in edges] == [("a",), ("b",)]
    assert len(state.active) == 2


@pytest.mark.parametrize("type_name", LAYOUTS)
def test_numbers_are_read_where_ros_writes_them(type_name: str) -> None:
    """Every field of every layout against the type library: the message holds another number in each."""
    paths, found = number_fields(type_name), build(type_name, iter(range(1, 100)))
    data = bytes(store.serialize_cdr(found, type_name))
    for path in paths:
        value: Any = found
        for part in path.split("."):
            value = getattr(value, part)
        assert number_in(type_name, path, data) == pytest.approx(float(value)), path
    with pytest.raises(ValueError, match="too early"):
        number_in(type_name, paths[-1], data[:4])


def build(type_name: str, counter: Iterator[int]) -> Any:
    """A message of the type library with a different number in each field, texts of three letters, empty lists."""
    fields: dict[str, Any] = {}
    for name, (kind, detail) in store.fielddefs[type_name][1]:
        if kind == Nodetype.NAME:
            fields[name] = build(detail, counter)
        elif kind != Nodetype.BASE:
            fields[name] = np.zeros(0, np.float32) if detail[0][1][0] == "float32" else []
        else:
            base = detail[0]
            fields[name] = "map" if base == "string" else float(next(counter)) if "float" in base else next(counter)
    return store.types[type_name](**fields)


def test_an_uncertain_vehicle_asks_for_help_and_gives_it_up(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.send(0.05, 0.3)
    assert stage.done() == ["start"]
    [task] = stage.tasks.objects.values()
    assert task["spec"]["application"] == "environment-perception"
    assert task["spec"]["parameters"] == {"sensor": "roadside-0"}
    assert task["spec"]["lease"] == {"seconds": 30}
    assert task["spec"]["chain"] == {"parent": "cloud-0/approach-1"}
    assert task["spec"]["reason"] == "vehicle-00: data above 0.15"
    assert task["metadata"]["annotations"] == {"robotkube.io/agents": "vehicle-00"}
    stage.send(0.02)
    assert stage.done() == ["start", "stop"]
    assert stage.tasks.objects == {}


def test_a_rule_that_always_holds_asks_once(stage: Stage) -> None:
    stage.apply(ALWAYS)
    stage.detector.turn()
    assert stage.done() == ["start"]
    assert [task["spec"]["reason"] for task in stage.tasks.objects.values()] == ["vehicle-00: near"]
    stage.apply({**ALWAYS, "rules": [], "reactions": []})
    assert stage.done() == ["start", "stop"]
    assert stage.tasks.objects == {}


@pytest.mark.parametrize("document", [DOCUMENT, ALWAYS])
def test_who_was_restarted_resumes_the_same_task(
    make_stage: Callable[[Tasks], Stage], document: Mapping[str, Any]
) -> None:
    tasks = Tasks()
    first = make_stage(tasks)
    first.apply(document)
    first.send(0.3)
    assert first.done() == ["start"]
    first.operators[0].stop(5.0)
    second = make_stage(tasks)
    second.apply(document)
    second.send(0.3)
    until(lambda: len(tasks.renewals) == 1)  # at once: nobody knows how old the lease is
    assert second.detector.events_document()["events"] == []
    assert [name for name, _ in tasks.renewals] == list(tasks.objects)


def test_tasks_of_another_chain_are_withdrawn(make_stage: Callable[[Tasks], Stage]) -> None:
    """The vehicle came again: another task launched the detector, under the same name, before the old ones had gone."""
    tasks = Tasks()
    first = make_stage(tasks)
    first.apply(ALWAYS)
    assert first.done() == ["start"]
    [stale] = tasks.objects
    first.operators[0].stop(5.0)
    second = make_stage(tasks)
    second.now += 1_000_000_000
    second.apply({**ALWAYS, "task": "cloud-0/approach-2"})
    assert second.done() == ["start"]
    [(name, task)] = tasks.objects.items()
    assert name != stale
    assert task["spec"]["chain"] == {"parent": "cloud-0/approach-2"}


@pytest.mark.parametrize("document", [DOCUMENT, ALWAYS])
def test_another_task_above_a_running_detector_begins_anew(stage: Stage, document: Mapping[str, Any]) -> None:
    stage.apply(document)
    stage.send(0.3)
    assert stage.done() == ["start"]
    [before] = stage.tasks.objects
    stage.now += 1_000_000_000
    stage.apply({**document, "task": "cloud-0/approach-2"})
    stage.send(0.3)
    assert stage.done() == ["start", "stop", "start"]
    [(name, task)] = stage.tasks.objects.items()
    assert name != before
    assert task["spec"]["chain"] == {"parent": "cloud-0/approach-2"}


def test_leases_are_renewed_every_third_of_their_time(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.send(0.3)
    assert stage.done() == ["start"]
    [name] = stage.tasks.objects
    assert stage.tasks.renewals == []
    stage.seconds = 10.1
    until(lambda: len(stage.tasks.renewals) == 1)
    stage.tasks.away = 1
    stage.seconds = 20.2
    until(lambda: stage.tasks.away == 0)
    stage.seconds = 25.3
    until(lambda: len(stage.tasks.renewals) == 2)
    assert stage.tasks.renewals == [(name, stage.now)] * 2
    assert time_text(stage.now).startswith("2026-11-21T08:33:20")


def test_a_task_that_somebody_deleted_is_renewed_no_more(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.send(0.3)
    assert stage.done() == ["start"]
    stage.tasks.objects.clear()
    for seconds in (11, 22, 33):
        stage.seconds = float(seconds)
        until(lambda: stage.tasks.renewals)
    stage.send(0.01)
    assert stage.done() == ["start", "stop"]
    assert len(stage.tasks.renewals) == 1


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"field": "value"}, "rules[uncertain].field: std_msgs/msg/Float64 has no number value; it has data"),
        ({"topic": "/other"}, "rules[uncertain].topic: /other is not listed under topics"),
        ({"stop_below": 0.2}, "rules[0].stop_below: must not lie beyond start_above"),
        ({"stop_below": None}, "rules[0].stop_below: is missing"),
        ({"start_below": 1}, "rules[0].start_below: unknown key"),
    ],
)
def test_mistakes_in_a_threshold_are_named(changes: Mapping[str, Any], expected: str) -> None:
    rule = {key: value for key, value in {**DOCUMENT["rules"][0], **changes}.items() if value is not None}
    with pytest.raises(DocumentError) as caught:
        read_detector_settings({**DOCUMENT, "rules": [rule]}, "config.yaml")
    assert expected in str(caught.value)
