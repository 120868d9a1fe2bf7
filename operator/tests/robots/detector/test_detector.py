"""The detector's service over topics and tasks in memory: what it subscribes, raises, withdraws and counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from robotkube.foundation.documents.core.times import time_ns, time_text
from robotkube.robots.reactions.core.settings import OperatorReactionSettings
from robotkube.robots.reactions.core.task_requests import event_of, event_task
from robotkube.robots.ros.core.common_messages import header_stamp, pose_position
from robotkube.robots.rules.core import START, Edge
from tests.stages.detector.in_memory import MS, NOW, DetectorStage, MemoryTasks, pose
from tests.stages.detector.proximity_settings import SETTINGS as DOCUMENT
from tests.stages.waiting import until

Stage = DetectorStage


@pytest.fixture
def tasks() -> MemoryTasks:
    return MemoryTasks()


@pytest.fixture
def make_stage(tasks: MemoryTasks) -> Iterator[Callable[[], Stage]]:
    stages: list[Stage] = []

    def make() -> Stage:
        stages.append(Stage(tasks))
        return stages[-1]

    yield make
    for stage in stages:
        stage.close()


@pytest.fixture
def stage(make_stage: Callable[[], Stage]) -> Stage:
    return make_stage()


def test_an_event_becomes_a_task_and_goes_with_it(stage: Stage, tasks: MemoryTasks) -> None:
    stage.apply(DOCUMENT)
    assert set(stage.live.topics) == {"/vehicles/vehicle_00/pose", "/vehicles/vehicle_01/pose"}
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 600)
    stage.send("vehicle-01", 399)
    until(lambda: stage.edges() == [(START, True)])
    (task,) = tasks.objects.values()
    (event,) = stage.events()
    assert event["time"] == stage.now
    assert event["stamp"] == stage.now - 5 * MS
    assert event["task"] == f"cloud-0/{task['metadata']['name']}"
    assert task["spec"]["parameters"] == {"vehicles": ["vehicle-00", "vehicle-01"], "n": 1}
    assert task["spec"]["reason"] == "vehicle-00, vehicle-01 within 400 m"
    assert task["spec"]["event"]["id"] == event["id"]
    assert time_ns(task["spec"]["event"]["time"]) == event["time"] // 1000 * 1000
    stage.send("vehicle-01", 501)
    until(lambda: stage.edges() == [(START, True), ("stop", True)])
    assert not tasks.objects
    assert stage.events()[1]["id"] == event["id"]


def test_topics_of_other_agents_are_found_and_counted(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.live.published = {
        "/vehicles/vehicle_07/pose": ["geometry_msgs/msg/PoseStamped"],
        "/vehicles/vehicle_08/pose": ["std_msgs/msg/String"],
        "/other": ["geometry_msgs/msg/PoseStamped"],
    }
    stage.now += 1001 * MS
    stage.detector.turn()
    assert set(stage.live.topics) == {f"/vehicles/vehicle_{n}/pose" for n in ("00", "01", "07")}
    for _ in range(3):
        stage.send("vehicle-07", 0, age_ms=12)
    counter = stage.detector.input_document()["topics"]["/vehicles/vehicle_07/pose"]
    assert counter["received"] == sum(count for _, count in counter["seconds"]) == 3
    assert counter["ages_ms"] == [[12, 3]]
    assert counter["type"] == "geometry_msgs/msg/PoseStamped"


def test_a_second_s_ages_have_quantiles_when_it_has_ended(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    for age in (10, 20, 30, 2000):
        stage.send("vehicle-00", 0, age_ms=age)

    def quantiles() -> list[list[int]]:
        ages: list[list[int]] = stage.detector.input_document()["topics"]["/vehicles/vehicle_00/pose"][
            "age_quantiles_ms"
        ]
        return ages

    assert quantiles() == []
    second = stage.now // (1000 * MS)
    stage.now += 1000 * MS
    stage.send("vehicle-00", 0, age_ms=12)
    assert quantiles() == [[second, 20, 1000]]


def test_malformed_messages_are_counted_and_change_nothing(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    stage.live.topics["/vehicles/vehicle_00/pose"].waiting = [(b"", 1), (b"\0\1\0\0abc", 2), (pose(1, 1)[:30], 3)]
    stage.detector.turn()
    counter = stage.detector.input_document()["topics"]["/vehicles/vehicle_00/pose"]
    assert counter["malformed"] == 3


def test_a_restarted_detector_takes_its_events_over(make_stage: Callable[[], Stage], tasks: MemoryTasks) -> None:
    first = make_stage()
    first.apply(DOCUMENT)
    first.send("vehicle-00", 0)
    first.send("vehicle-01", 100)
    until(lambda: len(tasks.objects) == 1)
    tasks.objects["foreign"] = {"metadata": {"name": "foreign"}, "spec": {"requester": "cloud-0/other"}}
    second = make_stage()
    second.apply(DOCUMENT)
    second.send("vehicle-00", 0)
    second.send("vehicle-01", 100)
    assert second.events() == []
    assert tasks.creations == 1
    second.send("vehicle-01", 600)
    until(lambda: second.edges() == [("stop", True)])
    assert list(tasks.objects) == ["foreign"]


def test_a_task_whose_rule_is_gone_is_withdrawn(make_stage: Callable[[], Stage], tasks: MemoryTasks) -> None:
    first = make_stage()
    first.apply(DOCUMENT)
    first.send("vehicle-00", 0)
    first.send("vehicle-01", 100)
    until(lambda: len(tasks.objects) == 1)
    second = make_stage()
    renamed = {**DOCUMENT, "rules": [{**DOCUMENT["rules"][0], "name": "closer"}]}
    renamed["reactions"] = [{**DOCUMENT["reactions"][0], "rule": "closer"}]
    second.apply(renamed)
    second.detector.turn()
    until(lambda: not tasks.objects)


def test_nothing_is_raised_before_own_tasks_are_known(stage: Stage, tasks: MemoryTasks) -> None:
    tasks.away = 2
    tasks.answering.clear()
    stage.apply(DOCUMENT, adopting=False)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    assert stage.events() == []
    assert "API server" in stage.detector.not_ready
    tasks.answering.set()
    until(lambda: stage.operators[0].adopted is not None)
    stage.send("vehicle-01", 100)
    stage.send("vehicle-00", 0)
    until(lambda: stage.edges() == [(START, True)])
    assert stage.detector.not_ready == ""


def test_an_api_server_that_stays_away_at_the_start_holds_rules_up_for_a_while(
    make_stage: Callable[[], Stage], tasks: MemoryTasks
) -> None:
    """Then events are raised, and the one that a predecessor has a task for goes on with that task."""
    first = make_stage()
    first.apply(DOCUMENT)
    first.send("vehicle-00", 0)
    first.send("vehicle-01", 100)
    until(lambda: len(tasks.objects) == 1)
    tasks.away = 10**6
    second = make_stage()
    second.now += 1_000 * MS
    second.apply(DOCUMENT, adopting=False)
    second.send("vehicle-00", 0)
    second.send("vehicle-01", 100)
    assert second.events() == []
    second.pass_seconds(5.1)
    second.send("vehicle-00", 0)
    second.send("vehicle-01", 100)
    assert [event["edge"] for event in second.events()] == ["start"]
    tasks.away = 0
    until(lambda: second.edges() == [(START, True)])
    assert (tasks.creations, second.events()[0]["task"]) == (1, f"cloud-0/{next(iter(tasks.objects))}")
    second.send("vehicle-01", 600)
    until(lambda: second.edges() == [(START, True), ("stop", True)])
    assert not tasks.objects


def test_an_api_server_that_is_away_gets_the_task_later(stage: Stage, tasks: MemoryTasks) -> None:
    stage.apply(DOCUMENT)
    tasks.away = 2
    tasks.answering.clear()
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)  # comes back before the API server has answered anything
    assert (stage.edges(), tasks.creations) == ([(START, False)], 0)
    tasks.answering.set()
    until(lambda: stage.edges() == [(START, True)])
    assert tasks.creations == 1


def test_an_event_that_ended_before_the_api_server_came_back_leaves_nothing(stage: Stage, tasks: MemoryTasks) -> None:
    stage.apply(DOCUMENT)
    tasks.away = 10**6
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    until(lambda: stage.events()[0]["error"] is not None)
    stage.send("vehicle-01", 600)
    tasks.away = 0
    until(lambda: len(stage.edges()) == 2 and stage.edges()[1][1])
    assert (tasks.creations, tasks.objects) == (0, {})
    assert stage.edges()[0] == (START, False)


def test_a_refusal_is_told_and_not_repeated(stage: Stage, tasks: MemoryTasks) -> None:
    stage.apply(DOCUMENT)
    tasks.refusing = True
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    until(lambda: stage.events()[0]["error"] == "Refused: forbidden")
    tasks.refusing = False
    stage.send("vehicle-01", 600)
    until(lambda: stage.edges()[-1] == ("stop", True))


def test_changed_settings_keep_what_goes_on(stage: Stage, tasks: MemoryTasks) -> None:
    stage.apply(DOCUMENT)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    until(lambda: stage.edges() == [(START, True)])
    rule = {**DOCUMENT["rules"][0], "stop_distance_m": 900}
    stage.apply({**DOCUMENT, "rules": [rule]})
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 800)
    assert len(stage.events()) == 1
    stage.send("vehicle-01", 901)
    until(lambda: stage.edges() == [(START, True), ("stop", True)])
    assert tasks.creations == 1


def test_a_rule_taken_away_ends_its_events(stage: Stage, tasks: MemoryTasks) -> None:
    stage.apply(DOCUMENT)
    stage.send("vehicle-00", 0)
    stage.send("vehicle-01", 100)
    until(lambda: len(tasks.objects) == 1)
    stage.apply({"name": DOCUMENT["name"], "topics": DOCUMENT["topics"]})
    until(lambda: not tasks.objects)


def test_a_topic_taken_away_is_closed(stage: Stage) -> None:
    stage.apply(DOCUMENT)
    before = dict(stage.live.topics)
    stage.apply({"name": DOCUMENT["name"], "topics": [{"name": "/tf", "type": "geometry_msgs/msg/PoseStamped"}]})
    assert all(topic.closed for topic in before.values())
    assert set(stage.status.document()["topics"]) == set(stage.detector.pool.buffers) == {"/tf"}


@pytest.mark.parametrize("frame", [b"", b"m", b"map", b"a_long_frame_name"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_fields_are_read_from_the_bytes(frame: bytes, order: str) -> None:
    data = pose(1_795_250_000_123_456_789, -12.5, frame, order)
    assert header_stamp(data) == 1_795_250_000_123_456_789
    assert pose_position(data) == (-12.5, 2.0, 3.0)


def test_a_task_tells_its_event_again() -> None:
    edge = Edge("near", START, ("a", "b"), "1" * 16, "2" * 32, NOW + 123_000, NOW, 12.0)
    task = event_task("cloud-0/d", OperatorReactionSettings("near", "recording", {}), edge, "{agents} within 400 m")
    assert event_of(task, "cloud-0/d") == replace(edge, distance_m=None)
    assert event_of(task, "cloud-0/e") is None
    assert event_of({"metadata": {}, "spec": {"requester": "cloud-0/d"}}, "cloud-0/d") is None
    leaving = {**task, "metadata": {**task["metadata"], "deletionTimestamp": "x"}}
    assert event_of(leaving, "cloud-0/d") is None
    assert time_text(NOW + 1000) == "2026-11-21T08:33:20.000001Z"
