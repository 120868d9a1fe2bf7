"""Stories rehearsed with the real manager and the real catalogue in memory: the scenario's own steps, done by its own
runner, and what its measures say of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.loops.planner import ManagerSettings
from robotkube.delivery.manager.loops.reconciler import NODES
from robotkube.foundation.documents.core.quantities import quantity
from scenarios import definition
from scenarios.runner.inputs import MainState, RunInputs
from scenarios.runner.judging import outcomes
from scenarios.runner.observing.tasks import TaskWatch
from scenarios.runner.playing import acting
from scenarios.steps import read_steps
from tests.stages.delivery.manager.manager_in_memory import CHARTS, Stage
from tests.stages.paths import WIDEST

APPLICATION = {"status": {"sync": {"status": "Synced"}, "health": {"status": "Healthy"}}}


def staged(scenario: definition.Scenario, folder: Path) -> Stage:
    """A manager for the machines of a scenario."""
    stage = Stage(folder)
    nodes = [node for node in scenario.nodes if node.role != "platform"]
    stage.settings = ManagerSettings(tuple(Agent(node.agent, node.role, node.agent) for node in nodes), CHARTS)
    stage.cluster.machines[:] = [_machine(node) for node in nodes]
    stage.manager = stage.start()
    stage.settle()
    return stage


def _machine(node: definition.Node) -> NodeState:
    capacity = Resources(int((quantity(node.cpu) or 0) * 1000), int(quantity(node.memory) or 0))
    return NodeState(node.name, node.agent, node.role, frozenset(node.capabilities), True, allocatable=capacity)


@dataclass
class Rehearsal:
    """What the runner's actor reads and does; each reading lets the manager go on, and Argo CD do its work."""

    stage: Stage
    watch: TaskWatch = field(default_factory=lambda: TaskWatch(None, lambda _: None))  # type: ignore[arg-type]
    history: list[MainState] = field(default_factory=list)

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        self.stage.settle()
        self._note()
        tasks = self.stage.tasks.tasks()
        for task in tasks:
            self.watch.note("MODIFIED", task)
        return tasks

    def task(self, namespace: str, name: str) -> Any:
        key = (namespace, name)
        return next((t for t in self.tasks() if (t["metadata"]["namespace"], t["metadata"]["name"]) == key), None)

    def create_task(self, body: Mapping[str, Any]) -> None:
        metadata = body["metadata"]
        self.stage.seconds += 1
        created = f"2026-11-21T10:00:{int(self.stage.seconds) % 60:02}Z"
        self.stage.tasks.create(metadata["namespace"], metadata["name"], body["spec"], created)

    def delete_task(self, namespace: str, name: str) -> None:
        task = self.stage.tasks.objects.get(f"{namespace}/{name}")
        if task is not None:
            self.watch.note("DELETED", task)
            self.stage.tasks.delete(f"{namespace}/{name}")

    def releases(self) -> Mapping[str, Any]:
        self.tasks()
        return {release.key: release for release in self.stage.releases().values()}

    def applications(self) -> Mapping[str, Any]:
        return dict.fromkeys(self.stage.cluster.states, APPLICATION)

    def state(self, _: Any) -> str:
        return "\n".join(acting_line(task) for task in self.stage.tasks.tasks())

    def _note(self) -> None:
        tasks = {
            release.key: tuple(cause.task for cause in release.causes) for release in self.stage.releases().values()
        }
        if not self.history or self.history[-1].tasks != tasks:
            self.history.append(MainState(str(len(self.history)), tasks))


def acting_line(task: Mapping[str, Any]) -> str:
    conditions = task.get("status", {}).get("conditions", [])
    return f"{task['metadata']['name']}: " + "; ".join(f"{c['reason']}: {c['message']}" for c in conditions)


def rehearse(rehearsal: Rehearsal, steps: Sequence[Any]) -> RunInputs:
    """Do the steps; what they leave behind, as the report's measures read it."""
    rehearsal.tasks()
    actor = acting.Actor(rehearsal, rehearsal, rehearsal.releases, lambda _: None)  # type: ignore[arg-type]
    actor.perform(tuple(replace(step, seconds=1.0) for step in steps))
    return inputs_of(rehearsal, actor)


def inputs_of(rehearsal: Rehearsal, actor: acting.Actor) -> RunInputs:
    """What was left behind so far."""
    nothing: dict[str, Any] = dict.fromkeys(
        ("stored", "recordings", "edges", "plans", "pull_requests", "commits", "pods"), ()
    )
    return RunInputs(
        run="rehearsal", provider="memory", started=0, ended=1, ledgers={}, input_before=None, input_after=None,
        broker=None, releases_before={}, releases_after={}, tasks=rehearsal.watch.lives(),
        history=tuple(rehearsal.history), steps=tuple(actor.done), **nothing,
    )  # fmt: skip


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Polls follow each other at once."""
    monkeypatch.setattr(acting, "POLL_SECONDS", 0.0)


def test_the_conflict_about_resources_ends_as_its_scenario_expects(tmp_path: Path) -> None:
    scenario = definition.load(definition.find("resource-conflict"))
    rehearsal = Rehearsal(staged(scenario, tmp_path))
    before = set(rehearsal.releases())
    inputs = rehearse(rehearsal, scenario.steps)
    assert outcomes.steps_reached(inputs) == 1
    counts = {
        "offloaded": len(outcomes.offloaded(scenario, inputs)),
        "postponed": len(outcomes.postponed(inputs)),
        "refused": len(outcomes.refused(inputs)),
        "preempted": len(outcomes.preempted(inputs)),
    }
    assert counts == dict.fromkeys(counts, 1)
    assert outcomes.reasons_named(scenario, inputs) == 1
    assert set(rehearsal.releases()) == before


def ask(name: str, sensor: str, **more: Any) -> dict[str, Any]:
    """A step that asks for a detection."""
    asked = {"namespace": "cloud-0", "name": name, "parameters": {"sensor": sensor}, **more}
    if "provides" not in more:
        asked["application"] = "object-detection"
    return {"name": name, "do": {"submit": asked}}


@pytest.mark.parametrize(
    ("role", "sensor"),
    [("cloud", "vehicle-01"), ("edge", "vehicle-01"), ("roadside", "roadside-0"), ("vehicle", "vehicle-01")],
)
def test_a_detection_runs_on_every_role_that_a_task_asks_for(tmp_path: Path, role: str, sensor: str) -> None:
    """Table I, p01."""
    rehearsal = Rehearsal(staged(definition.load(WIDEST), tmp_path))
    where = {"roles": [role], **({"agents": [sensor]} if role == "vehicle" else {})}
    step = ask("on", sensor, placement=where)
    acting.Actor(rehearsal, rehearsal, rehearsal.releases, lambda _: None)._step(read_steps([step])[0])  # type: ignore[arg-type]
    detections = [name for name in rehearsal.releases() if name.endswith(f"/object-detection-{sensor}")]
    roles = {node.agent: node.role for node in definition.load(WIDEST).nodes}
    assert [roles[name.partition("/")[0]] for name in detections] == [role]


def test_requirements_choose_the_version(tmp_path: Path) -> None:
    """Table I, p09."""
    rehearsal = Rehearsal(staged(definition.load(WIDEST), tmp_path))
    actor = acting.Actor(rehearsal, rehearsal, rehearsal.releases, lambda _: None)  # type: ignore[arg-type]
    wanted = {
        "exact": ("vehicle-00", {"guarantee": "position-error", "atMost": 0.5, "unit": "m"}),
        "fast": ("vehicle-01", {"guarantee": "latency-p99", "atMost": 60, "unit": "ms"}),
        "impossible": ("vehicle-02", {"guarantee": "range", "atLeast": 500, "unit": "m"}),
    }
    for name, (sensor, requirement) in wanted.items():
        more = {"provides": "perception/detection", "requirements": [requirement], "placement": {"roles": ["cloud"]}}
        actor._step(read_steps([ask(name, sensor, **more)])[0])
    releases = rehearsal.releases()
    assert releases["cloud-0/object-detection-vehicle-00"].version == "0.1.2"
    assert releases["cloud-0/object-detection-vehicle-01"].version == "0.2.3"
    refused = rehearsal.task("cloud-0", "impossible")["status"]["conditions"][0]
    assert (refused["reason"], "range" in refused["message"]) == ("GuaranteeNotMet", True)


def test_what_ran_on_a_lost_node_runs_on_another(tmp_path: Path) -> None:
    """Table I, p06: the commit says why."""
    stage = staged(definition.load(WIDEST), tmp_path)
    rehearsal = Rehearsal(stage)
    actor = acting.Actor(rehearsal, rehearsal, rehearsal.releases, lambda _: None)  # type: ignore[arg-type]
    actor._step(read_steps([ask("anywhere", "roadside-0", placement={"roles": ["roadside", "edge"]})])[0])
    [before] = [name for name in rehearsal.releases() if name.endswith("/object-detection-roadside-0")]
    lost = before.partition("/")[0]
    now = 1795250000_000000000 + int(stage.seconds * 1e9)
    stage.cluster.machines[:] = [
        replace(node, ready=False, not_ready_since=now, silent_since=now) if node.agent == lost else node
        for node in stage.cluster.machines
    ]
    stage.seconds += 41
    stage.go(wake=NODES)
    stage.settle()
    [after] = [name for name in rehearsal.releases() if name.endswith("/object-detection-roadside-0")]
    assert {before, after} == {"edge-0/object-detection-roadside-0", "roadside-0/object-detection-roadside-0"}
    message = stage.repository.log(None, 1)[-1].message
    assert f"node {lost} lost for " in message
    assert "RobotKube-Cause: node" in message


@pytest.mark.parametrize(
    ("application", "launched"),
    [
        ("roadside-operator", "roadside-0/roadside-operator-vehicle-00"),
        ("uncertainty-operator", "vehicle-00/uncertainty-operator-roadside-0"),
    ],
)
def test_a_chain_of_operators_is_launched_and_goes_from_its_top(
    tmp_path: Path, application: str, launched: str
) -> None:
    """Intersection-support and Table I, p03 and p08: what its operators ask for, as main says that they ask for it."""
    scenario = definition.load(definition.find("intersection-support"))
    rehearsal = Rehearsal(staged(scenario, tmp_path))
    before = set(rehearsal.releases())
    parameters = {"site": "roadside-0", "vehicle": "vehicle-00"}
    top = {"namespace": "cloud-0", "name": "approach", "application": application, "parameters": parameters}
    actor = acting.Actor(rehearsal, rehearsal, rehearsal.releases, lambda _: None)  # type: ignore[arg-type]
    [step] = read_steps([{"name": "top", "do": {"submit": top}, "until": [{"release": launched, "is": "ready"}]}])
    actor._step(step)
    [reaction] = rehearsal.releases()[launched].values["detector"]["reactions"]
    child = {
        "namespace": launched.partition("/")[0],
        "name": "near",
        "application": reaction["application"],
        "parameters": reaction["parameters"],
        "chain": {"parent": "cloud-0/approach"},
    }
    services = ("roadside-0/object-detection-roadside-0", "roadside-0/object-tracking-roadside-0")
    steps = [
        {
            "name": "child",
            "do": {"submit": child},
            "until": [{"release": service, "is": "ready"} for service in services],
        },
        {"name": "gone", "do": {"delete": "cloud-0/approach"}},
    ]
    actor._step(read_steps(steps)[0])
    assert set(services) < set(rehearsal.releases())
    assert results_on(rehearsal, "vehicle-00") == results_from(rehearsal, "roadside-0") == ["objects", "tracks"]
    actor._step(read_steps(steps)[1])
    assert set(rehearsal.releases()) == before
    assert results_on(rehearsal, "vehicle-00") == []
    assert outcomes.chain_depth(inputs_of(rehearsal, actor)) == 2


def results_on(rehearsal: Rehearsal, agent: str) -> list[str]:
    """What of the road-side unit's results the bridge of an agent brings in."""
    return _results(rehearsal.releases().get(f"{agent}/mqtt-bridge"), "in")


def results_from(rehearsal: Rehearsal, agent: str) -> list[str]:
    """What of the road-side unit's results the bridge of an agent sends."""
    return _results(rehearsal.releases().get(f"{agent}/mqtt-bridge"), "out")


def _results(bridge: Any, direction: str) -> list[str]:
    topics = bridge.values["bridge"][direction] if bridge else []
    names = [topic["name"].removeprefix("/vehicles/roadside_0/") for topic in topics]
    return sorted(name for name in names if name in ("objects", "tracks"))


def test_two_recordings_share_the_uplink_of_the_vehicle_in_both(tmp_path: Path) -> None:
    """Three-vehicles: one release with two demands, kept until the second ends, its clouds sent once."""
    scenario = definition.load(definition.find("three-vehicles"), variant="small")
    rehearsal = Rehearsal(staged(scenario, tmp_path))
    before = rehearsal.releases()
    named = []
    for step in (
        {"do": {"submit": record("first", "vehicle-00", "vehicle-01")}},
        {"do": {"submit": record("second", "vehicle-01", "vehicle-02")}},
        {"do": {"delete": "cloud-0/first"}},
        {"do": {"delete": "cloud-0/second"}},
    ):
        actor = acting.Actor(rehearsal, rehearsal, rehearsal.releases, lambda _: None)  # type: ignore[arg-type]
        actor._step(read_steps([{"name": "step", **step}])[0])
        uplink = rehearsal.releases()["vehicle-01/mqtt-bridge"]
        topics = [topic["name"] for topic in uplink.values["bridge"]["out"]]
        named.append((len(uplink.causes), topics.count(definition.cloud_topic("vehicle-01"))))
    assert named == [(1, 1), (2, 1), (1, 1), (0, 0)]
    assert {name: release.values for name, release in rehearsal.releases().items()} == {
        name: release.values for name, release in before.items()
    }


def record(name: str, *vehicles: str) -> dict[str, Any]:
    """What the proximity rule asks for."""
    application = "pose-point-cloud-recording"
    return {"namespace": "cloud-0", "name": name, "application": application, "parameters": {"vehicles": [*vehicles]}}
