"""The scenario's runner against a real API server: the tasks of every story are taken, watched, and withdrawn."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from kubernetes import client

from ci.cluster_contract.provider import ServicePort
from robotkube.robots.bags.core.playback import read_run
from scenarios import definition
from scenarios.runner.observing.tasks import TaskWatch
from scenarios.runner.platform.access import GATE, PLATFORM, Access
from scenarios.runner.playing import acting, driving
from scenarios.runner.waiting import RunError
from tests.stages.kubernetes.api_calls import Api
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.waiting import until

pytestmark = pytest.mark.toolchain

SCENARIOS = Path(definition.__file__).parent
SUBMITTED = [
    step.given
    for file in sorted(SCENARIOS.glob("*/scenario.yaml"))
    for step in definition.load(file.parent).steps
    if step.action == "submit"
]


@pytest.fixture
def access(api_server: ApiServerProcess, api: Api) -> Iterator[Access]:
    reached = Access(api_server.kubeconfig)
    for namespace in {given["namespace"] for given in SUBMITTED} | {PLATFORM, GATE}:
        with contextlib.suppress(client.ApiException):  # it is there already
            reached.core.create_namespace({"metadata": {"name": namespace}})
    yield reached
    for task in reached.tasks():
        reached.delete_task(task["metadata"]["namespace"], task["metadata"]["name"])
    reached.disconnect()


def test_players_drive_on_until_their_last_event_is_over(access: Access) -> None:
    scenario = definition.load(SCENARIOS / "pose-point-cloud-db-recording", variant="small")
    for namespace in {*scenario.players, "cloud-0"}:
        with contextlib.suppress(client.ApiException):  # it is there already
            access.core.create_namespace({"metadata": {"name": namespace}})
    said: list[str] = []
    driving.drive(access, scenario, 10, said.append)
    orders = [read_run(access.simulation(agent), agent) for agent in scenario.players]
    assert orders[0] is not None
    assert set(orders) == {orders[0]}, "all of them on one clock"
    assert orders[0].laps * orders[0].lap == pytest.approx(600e9, rel=0.1)
    named = {"namespace": "cloud-0", "requester": "x", "reason": "x", "application": "greeting", "parameters": {}}
    body = acting.task({**named, "name": "near"})
    body["spec"]["event"]["rule"] = scenario.story.rule
    access.create_task(body)
    access.create_task(acting.task({**named, "name": "by-hand"}))
    stopping = threading.Thread(target=driving.stop, args=(access, scenario, said.append))
    stopping.start()
    stopping.join(2.5)
    assert stopping.is_alive(), "an event lasts"
    assert access.simulation("vehicle-00")
    access.delete_task("cloud-0", "near")
    stopping.join(20)
    assert not stopping.is_alive()
    assert not any(access.simulation(agent) for agent in scenario.players)
    driving.drive(access, scenario, 0, said.append)  # they stand already
    assert len(said) == 2


def test_tasks_of_all_stories_are_taken_watched_and_withdrawn(access: Access) -> None:
    watch = TaskWatch(access, lambda _: None)
    watch.start()
    try:
        assert len(SUBMITTED) >= 6
        for given in SUBMITTED:
            access.create_task(acting.task(given))
        keys = {f"{given['namespace']}/{given['name']}" for given in SUBMITTED}
        until(lambda: {life.key for life in watch.lives()} >= keys, "all tasks are seen")
        task = access.task(SUBMITTED[0]["namespace"], SUBMITTED[0]["name"])
        assert task["spec"]["application"] == SUBMITTED[0]["application"]
        for key in keys:
            access.delete_task(*key.split("/", 1))
            access.delete_task(*key.split("/", 1))
        until(lambda: all(life.deleted for life in watch.lives() if life.key in keys), "all tasks are gone")
    finally:
        watch.stop()


def test_what_the_api_server_refuses_is_said(access: Access) -> None:
    wrong = {"namespace": "cloud-0", "name": "wrong", "application": "x", "provides": "perception/detection"}
    with pytest.raises(RunError, match="task cloud-0/wrong: 422"):
        access.create_task(acting.task(wrong))


def test_nodes_are_cordoned_and_parts_of_the_platform_killed(access: Access) -> None:
    access.core.create_node({"metadata": {"name": "edge-9"}})
    try:
        access.set_schedulable("edge-9", False)
        assert access.core.read_node("edge-9").spec.unschedulable is True
        access.set_schedulable("edge-9", True)
        assert not access.core.read_node("edge-9").spec.unschedulable
    finally:  # the server is others' as well
        access.core.delete_node("edge-9")
    pod = {"metadata": {"name": "manager-x", "labels": {"app.kubernetes.io/name": "manager"}}}
    access.core.create_namespaced_pod(PLATFORM, pod | {"spec": {"containers": [{"name": "m", "image": "m"}]}})
    access.kill("gate")
    assert [one.metadata.name for one in access.pods(PLATFORM)] == ["manager-x"]
    gate = {"metadata": {"name": "gate-x", "labels": {"app.kubernetes.io/name": "gate"}}}
    access.core.create_namespaced_pod(GATE, gate | {"spec": {"containers": [{"name": "g", "image": "g"}]}})
    access.kill("manager")
    assert list(access.pods(PLATFORM)) == []
    assert [one.metadata.name for one in access.pods(GATE)] == ["gate-x"]
    access.kill("gate")
    assert list(access.pods(GATE)) == []


def test_nothing_runs_inside_a_pod_that_is_not_there(access: Access) -> None:
    with pytest.raises(RunError, match=rf"pod {PLATFORM}/nobody: python3 cannot be run in it: (?s:.*)404 Not Found"):
        access.run_inside(PLATFORM, "nobody", ["python3", "-c", ""], 5)
    assert isinstance(access.tasks(), list), "what the stream did to its connection is not done to this one"


def test_services_are_reached_as_the_cluster_says(access: Access, api_server: ApiServerProcess) -> None:
    ports = [{"name": "https", "port": 3000}]
    access.core.create_namespaced_service(PLATFORM, {"metadata": {"name": "reached"}, "spec": {"ports": ports}})
    asked: list[ServicePort] = []

    def reach(service: ServicePort) -> tuple[str, int]:
        asked.append(service)
        return "localhost", 40_000

    try:
        direct = access.endpoint("reached")
        assert (direct.port, direct.encrypted) == (3000, True)
        forwarded = Access(api_server.kubeconfig, reach)
        assert forwarded.endpoint("reached").url == "https://localhost:40000"
        assert asked == [ServicePort(PLATFORM, "reached", direct.host, 3000)]
        forwarded.disconnect()
    finally:
        access.core.delete_namespaced_service("reached", PLATFORM)
