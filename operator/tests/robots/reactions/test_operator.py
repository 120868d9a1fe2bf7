"""Rules besides proximity, leases and chains: tasks that are renewed, resumed and withdrawn."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from robotkube.foundation.documents.core.times import time_text
from robotkube.robots.reactions.loops import operator as module
from robotkube.robots.reactions.loops.operator import OperatorReactions
from tests.stages.detector.in_memory import DetectorStage, MemoryTasks
from tests.stages.waiting import WAIT_SECONDS_MAX, until

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


class Stage(DetectorStage):
    """Numbers come on TOPIC."""

    def send(self, *values: float) -> None:  # type: ignore[override]
        self.say(TOPIC, *values)


@pytest.fixture
def make_stage() -> Iterator[Callable[[MemoryTasks], Stage]]:
    stages: list[Stage] = []

    def make(tasks: MemoryTasks) -> Stage:
        stages.append(Stage(tasks))
        return stages[-1]

    yield make
    for stage in stages:
        stage.close()


@pytest.fixture
def stage(make_stage: Callable[[MemoryTasks], Stage]) -> Stage:
    return make_stage(MemoryTasks())


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
    make_stage: Callable[[MemoryTasks], Stage], document: Mapping[str, Any]
) -> None:
    tasks = MemoryTasks()
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


def test_tasks_of_another_chain_are_withdrawn(make_stage: Callable[[MemoryTasks], Stage]) -> None:
    """The vehicle came again: another task launched the detector, under the same name, before the old ones had gone."""
    tasks = MemoryTasks()
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


def test_a_withdrawal_that_was_given_up_is_made_when_the_api_server_is_back(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.send(0.3)
    assert stage.done() == ["start"]
    stage.tasks.away = 10**6
    stage.send(0.01)
    stage.detector.turn()
    [operator] = stage.operators
    until(lambda: operator.counts()["retries"] > 0)
    stage.seconds += 4000.0
    until(lambda: operator.counts()["dead"] == 1)
    assert stage.tasks.objects
    assert stage.tasks.renewals == [], "nobody asks for it any more"
    stage.tasks.away = 0
    stage.seconds += 11.0
    until(lambda: not stage.tasks.objects)
    assert stage.tasks.renewals == []


def test_withdrawals_for_which_there_was_no_room_are_made_later(
    make_stage: Callable[[MemoryTasks], Stage], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "QUEUE_MAX", 1)
    stage = make_stage(MemoryTasks())
    stage.apply(DOCUMENT)
    stage.send(0.3)
    assert stage.done() == ["start"]
    [operator] = stage.operators
    stage.tasks.away = 10**6
    for number, value in enumerate((0.01, 0.3, 0.01, 0.3, 0.01)):
        stage.now += 1_000_000_000
        stage.send(value)
        stage.detector.turn()
        if not number:
            until(lambda: operator.counts()["retries"] > 0)  # the first stop is being tried: one start has room
    assert operator.counts()["dead"] == 3
    stage.tasks.away = 0
    until(lambda: stage.tasks.creations == 2 and not stage.tasks.objects)


def test_a_task_that_somebody_deleted_is_renewed_no_more(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.send(0.3)
    assert stage.done() == ["start"]
    stage.tasks.objects.clear()
    for seconds in (11, 22, 33):
        stage.seconds = float(seconds)
        looks = stage.tasks.looks
        until(lambda looks=looks: stage.tasks.looks > looks)
    stage.send(0.01)
    assert stage.done() == ["start", "stop"]
    assert len(stage.tasks.renewals) == 1


class Watched(OperatorReactions):
    """Notes whether the API server was known to be there when the tasks had been taken over."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "adopted" and value is not None:
            self.reached = self.reachable
        super().__setattr__(name, value)


def test_whose_tasks_are_taken_over_has_reached_the_api_server() -> None:
    operator = Watched("cloud-0/d", "cloud-0", MemoryTasks(), lambda: 0, lambda: 0.0)
    operator.start()
    until(lambda: operator.adopted is not None)
    operator.stop(5.0)
    assert operator.reached


class Held(queue.Queue[Any]):
    """What is taken from it is held up on its way."""

    taken, going = threading.Event(), threading.Event()

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        order = super().get(block, timeout)
        self.taken.set()
        assert self.going.wait(WAIT_SECONDS_MAX)
        return order


def test_what_is_just_being_taken_up_is_carried_out_before_the_end(
    make_stage: Callable[[MemoryTasks], Stage], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("queue.Queue", Held)
    stage = make_stage(MemoryTasks())
    stage.apply(DOCUMENT)
    stage.send(0.3)
    assert Held.taken.wait(WAIT_SECONDS_MAX)
    ending = threading.Thread(target=stage.operators[0].stop, args=(5.0,))
    ending.start()
    ending.join(0.2)
    Held.going.set()
    ending.join(WAIT_SECONDS_MAX)
    assert stage.edges() == [("start", True)]


def test_an_api_server_that_goes_away_in_silence_makes_it_not_ready(make_stage: Callable[[MemoryTasks], Stage]) -> None:
    tasks = MemoryTasks()
    stage = make_stage(tasks)
    stage.apply(DOCUMENT)
    assert stage.status.not_ready() == ""
    tasks.away = 10**6
    stage.seconds += 11
    until(lambda: "API server" in stage.status.not_ready())
    tasks.away = 0
    stage.seconds += 11
    until(lambda: stage.status.not_ready() == "")


def test_the_end_is_heard_while_nothing_is_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT_SECONDS", 600)
    reactions = OperatorReactions("cloud-0/d", "cloud-0", MemoryTasks(), time.time_ns, time.monotonic)
    reactions.start()
    until(lambda: reactions.adopted is not None, "adopted")
    reactions.stop(WAIT_SECONDS_MAX)
    assert not reactions._thread.is_alive()
    assert reactions.counts()["waiting"] == 0
