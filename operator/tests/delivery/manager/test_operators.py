"""Several managers, operators within them, chains of operators, devices that hold changes, agents that come and go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.core.placement.scopes import Operators, Scope
from robotkube.delivery.manager.loops.reconciler import DEPLOYMENT, NODES
from robotkube.delivery.manager.loops.unknown_agents import EVENTS_AT_ONCE_MAX
from robotkube.delivery.manager.loops.upkeep import ORPHAN_SECONDS
from robotkube.delivery.tasks.core.holds import DeviceHold
from robotkube.delivery.tasks.loops.device_holds import DeviceHolds
from robotkube.delivery.tasks.loops.mqtt_gateway import MqttTaskGateway
from robotkube.delivery.tasks.ports.mqtt_gateway import GatewayMessage
from robotkube.errors import UnavailableError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.testing.clusters import MemoryTasks
from robotkube.testing.task_gateways import MemoryGatewayChannel, MemoryTaskWriter
from tests.stages.delivery.manager.manager_in_memory import START_NS, Stage

SOUTH = ("vehicle-00", "vehicle-01", "cloud-0")
NORTH = ("vehicle-02", "cloud-1")
MINUTE_NS = 60_000_000_000


def scoped(stage: Stage, agents: tuple[str, ...], **declared: Scope) -> None:
    """The stage's manager begins anew with this scope, and operators by namespace (hyphens as underscores)."""
    names = frozenset(agents)
    operators = Operators(Scope(names, names), {key.replace("_", "-"): scope for key, scope in declared.items()})
    stage.settings = replace(stage.settings, operators=operators)
    stage.tasks.namespaces = names
    stage.manager = stage.start()


def with_agent(stage: Stage, name: str, role: str, *capabilities: str) -> Stage:
    """One more agent with a Node."""
    stage.settings = replace(stage.settings, agents=(*stage.settings.agents, Agent(name, role, name)))
    stage.cluster.machines.append(NodeState(name, name, role, frozenset(capabilities), True))
    return stage


def neighbour(stage: Stage, folder: Path, agents: tuple[str, ...]) -> Stage:
    """Another manager on the same stage."""
    other = Stage(folder)
    other.settings, other.verifier, other.catalogue = stage.settings, stage.verifier, stage.catalogue
    other.cluster, other.repository, other.forge = stage.cluster, stage.repository, stage.forge
    other.tasks = MemoryTasks(stage.tasks.objects)
    scoped(other, agents)
    return other


def namespaces(stage: Stage) -> set[str]:
    return {release.namespace for release in stage.releases().values()}


def message(stage: Stage, key: str, kind: str) -> str:
    conditions = stage.tasks.objects[key]["status"]["conditions"]
    return str(next(c["message"] for c in conditions if c["type"] == kind))


# -- several managers ---------------------------------------------------------------------------------------------


def test_each_manager_gives_its_agents_the_initial_configuration(tmp_path: Path) -> None:
    stage = with_agent(Stage(tmp_path / "south"), "cloud-1", "cloud", "recording")
    scoped(stage, SOUTH)
    other = neighbour(stage, tmp_path / "north", NORTH)
    stage.settle()
    assert namespaces(stage) == set(SOUTH)
    other.settle()
    assert namespaces(stage) == {*SOUTH, *NORTH}
    before = stage.repository.tip
    for manager in (stage, other):
        manager.go(8, seconds=RESYNC_SECONDS, wake=DEPLOYMENT)
    assert stage.repository.tip == before, "neither touches what the other wrote"


def test_a_manager_does_not_answer_for_agents_of_another(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    scoped(stage, SOUTH)
    stage.settle()
    key = stage.ask(vehicles=("vehicle-00", "vehicle-02"))
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", "OutsideScope")
    assert "agent 'vehicle-02' belongs to another scope; this one holds cloud-0, vehicle-00" in message(
        stage, key, "Accepted"
    )


def test_a_manager_does_not_see_tasks_of_another(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    scoped(stage, NORTH)
    stage.settle()
    key = stage.ask()
    stage.go()
    assert "status" not in stage.tasks.objects[key]


def test_an_operator_may_do_less_than_its_manager(stage: Stage) -> None:
    scoped(stage, (*SOUTH, *NORTH), cloud_0=Scope(agents=frozenset({"cloud-0", "vehicle-00"})))
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", "OutsideScope")
    assert "leads to releases on vehicle-01: its operator may touch cloud-0, vehicle-00" in message(
        stage, key, "Accepted"
    )
    scoped(stage, (*SOUTH, *NORTH), cloud_0=Scope(applications=frozenset({"object-detection"})))
    stage.go()
    assert "its operator may launch object-detection" in message(stage, key, "Accepted")
    assert "recorder" not in "".join(stage.releases())


# -- chains -------------------------------------------------------------------------------------------------------


def intersection(folder: Path) -> Stage:
    """A road-side unit besides, and a task of the cloud that launched an operator there."""
    stage = Stage(folder, vehicles=1)
    stage.manager = with_agent(stage, "roadside-0", "roadside").start()
    stage.settle()
    stage.ask("near", application="roadside-operator", parameters={"site": "roadside-0", "vehicle": "vehicle-00"})
    stage.settle()
    assert "releases/roadside-0/roadside-operator-vehicle-00.yaml" in stage.releases()
    return stage


def child(
    stage: Stage, name: str = "look", parent: str = "cloud-0/near", namespace: str = "roadside-0", **spec: Any
) -> str:
    document = {
        **stage.tasks.objects["cloud-0/near"]["spec"],
        "requester": f"{namespace}/roadside-operator-vehicle-00",
        "application": "environment-perception",
        "parameters": {"sensor": "roadside-0"},
        "chain": {"parent": parent},
        **spec,
    }
    stage.tasks.create(namespace, name, document, created="2026-11-21T10:00:01Z")
    return f"{namespace}/{name}"


def test_a_launched_operator_asks_for_services_and_they_go_with_it(tmp_path: Path) -> None:
    stage = intersection(tmp_path)
    key = child(stage)
    stage.settle()
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged"), stage.tasks.objects[key]
    assert any("object-detection" in path for path in stage.releases())
    stage.tasks.delete("cloud-0/near")
    stage.settle()
    assert stage.tasks.condition(key, "Accepted") == ("False", "ParentWithdrawn")
    assert "its chain has ended at cloud-0/near: it is withdrawn" in message(stage, key, "Accepted")
    assert not any("object-" in path or "roadside-operator" in path for path in stage.releases())


def test_a_task_without_its_parent_is_deleted_after_a_while(tmp_path: Path) -> None:
    stage = intersection(tmp_path)
    key, below = child(stage), child(stage, "below", parent="roadside-0/look")
    stage.go()
    stage.tasks.delete("cloud-0/near")
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", "ParentWithdrawn")
    assert stage.tasks.condition(below, "Accepted") == ("False", "ParentWithdrawn")
    stage.go(1, seconds=ORPHAN_SECONDS)
    stage.go(1, seconds=ORPHAN_SECONDS)
    assert (key in stage.tasks.objects, below in stage.tasks.objects) == (False, True)
    stage.go(1, seconds=ORPHAN_SECONDS)
    stage.go(1)
    assert below not in stage.tasks.objects


def test_a_refused_parent_keeps_its_childrens_objects(tmp_path: Path) -> None:
    stage = intersection(tmp_path)
    key = child(stage)
    stage.tasks.objects["cloud-0/near"]["spec"]["parameters"] = {}
    stage.go(4, seconds=ORPHAN_SECONDS)
    assert stage.tasks.condition(key, "Accepted") == ("False", "ParentWithdrawn")


def test_what_a_refused_operator_launched_goes_in_the_same_plan(tmp_path: Path) -> None:
    stage = intersection(tmp_path)
    key = child(stage)
    stage.settle()
    plans = len(stage.plans())
    stage.tasks.objects["cloud-0/near"]["spec"]["parameters"] = {"site": "roadside-0"}
    stage.tasks.objects["cloud-0/near"]["metadata"]["generation"] = 2
    stage.go()
    assert stage.tasks.condition("cloud-0/near", "Accepted") == ("False", "InvalidParameters")
    assert stage.tasks.condition(key, "Accepted") == ("False", "ParentWithdrawn")
    assert not any("object-" in path or "roadside-operator" in path for path in stage.releases())
    assert len(stage.plans()) == plans + 1


def test_a_child_never_does_more_than_its_parent(tmp_path: Path) -> None:
    stage = intersection(tmp_path)
    narrow = Scope(agents=frozenset({"roadside-0"}), applications=frozenset({"roadside-operator"}))
    scoped(stage, ("vehicle-00", "cloud-0", "roadside-0"), cloud_0=narrow)
    key = child(stage)
    own = child(stage, "own", chain={})
    stage.go()
    assert stage.tasks.condition("cloud-0/near", "Committed") == ("True", "Merged")
    assert stage.tasks.condition(key, "Accepted") == ("False", "OutsideScope")
    assert "its operator may launch roadside-operator" in message(stage, key, "Accepted")
    assert stage.tasks.condition(own, "Accepted") == ("True", "Accepted"), "it is its manager's scope that bounds this"


def test_nobody_can_name_a_parent_that_launched_nothing_there(tmp_path: Path) -> None:
    stage = intersection(tmp_path)
    key = child(stage, namespace="vehicle-00")
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("False", "OutsideScope")
    assert "no release of that task is an event detector in namespace vehicle-00" in message(stage, key, "Accepted")


# -- holds --------------------------------------------------------------------------------------------------------


def hold(stage: Stage, agent: str, seconds: float = 60.0) -> None:
    until = START_NS + int((stage.seconds + seconds) * 1e9)
    stage.cluster.machines = [
        replace(node, hold=DeviceHold(agent, until, "driving")) if node.agent == agent else node
        for node in stage.cluster.machines
    ]


def release(stage: Stage) -> None:
    stage.cluster.machines = [replace(node, hold=None) for node in stage.cluster.machines]


def test_changes_of_a_driving_agent_wait_until_it_parks(stage: Stage) -> None:
    hold(stage, "vehicle-00")
    before = {path: r for path, r in stage.releases().items() if r.namespace == "vehicle-00"}
    key = stage.ask()
    stage.go()
    assert stage.tasks.condition(key, "Accepted") == ("True", "Accepted")
    assert stage.tasks.condition(key, "Committed") == ("False", "HeldByAgent")
    assert "vehicle-00/mqtt-bridge: vehicle-00 holds changes until" in message(stage, key, "Committed")
    assert message(stage, key, "Committed").endswith("driving")
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" in stage.releases()
    assert {path: r for path, r in stage.releases().items() if r.namespace == "vehicle-00"} == before
    release(stage)
    stage.go(wake=NODES)
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_a_hold_ends_by_itself(stage: Stage) -> None:
    hold(stage, "vehicle-00", seconds=30.0)
    key = stage.ask()
    stage.go()
    assert stage.manager.step() <= 30.0, "the manager looks again when it ends"
    assert stage.tasks.condition(key, "Committed") == ("False", "HeldByAgent")
    stage.seconds += 31.0
    for _ in range(4):
        stage.manager.step()
        stage.notify()
        stage.seconds += 0.1
    assert stage.tasks.condition(key, "Committed") == ("True", "Merged")


def test_what_goes_from_a_driving_agent_waits_too(stage: Stage) -> None:
    key = stage.ask()
    stage.settle()
    hold(stage, "vehicle-00")
    stage.tasks.delete(key)
    stage.go()
    assert "releases/cloud-0/recorder-vehicle-00-vehicle-01.yaml" not in stage.releases()
    assert any(key in {c.task for c in r.causes} for r in stage.releases().values() if r.namespace == "vehicle-00")
    release(stage)
    stage.go(wake=NODES)
    assert not any(key in {c.task for c in r.causes} for r in stage.releases().values())


def test_a_device_reports_it_by_message(stage: Stage) -> None:
    woken: list[str] = []
    holds = DeviceHolds(lambda: START_NS, lambda: woken.append(NODES))
    channel = MemoryGatewayChannel()
    tasks = MemoryTasks()
    operators = {"vehicle-00": "vehicle-00"}
    writer = MemoryTaskWriter(tasks)
    clock = (lambda: START_NS, lambda: 0.0)
    gateway = MqttTaskGateway(operators, channel, tasks, writer, stage.leadership, *clock, holds.receive)

    def say(payload: bytes, agent: str = "vehicle-00", size: int | None = None) -> None:
        channel.waiting.append(
            GatewayMessage(f"robotkube/holds/{agent}", payload, len(payload) if size is None else size)
        )
        gateway.turn(0.0)

    say(b'{"reason": "driving", "until": "2027-01-01T00:00:00Z"}')
    [hold] = holds()
    assert (hold.agent, hold.reason) == ("vehicle-00", "driving")
    say(b"gibberish")
    say(b"", size=1_000_000)
    say(b'{"reason": "driving", "until": "2027-01-01T00:00:00Z"}', agent="vehicle-09")
    assert list(holds()) == [hold]
    say(b"")
    assert (list(holds()), woken) == ([], [NODES, NODES])
    assert len(channel.acknowledged) == 5


# -- agents -------------------------------------------------------------------------------------------------------


@pytest.fixture
def late(tmp_path: Path) -> Stage:
    """vehicle-15 is declared, and not there yet."""
    stage = Stage(tmp_path)
    stage.settings = replace(
        stage.settings, agents=(*stage.settings.agents, Agent("vehicle-15", "vehicle", "vehicle-15"))
    )
    stage.manager = stage.start()
    stage.settle()
    return stage


def node(name: str, agent: str) -> NodeState:
    return NodeState(name, agent, "vehicle", frozenset(), True)


def test_a_declared_agent_that_joins_gets_what_its_role_has(late: Stage) -> None:
    before = late.releases()
    assert "vehicle-15" not in namespaces(late)
    late.cluster.machines.append(node("node-15", "vehicle-15"))
    late.go(wake=NODES)
    new = {path for path in late.releases() if path not in before}
    assert new == {path.replace("vehicle-00", "vehicle-15") for path in before if "/vehicle-00/" in path}
    assert late.plans()[-1]["cause"] == "initial"


def test_an_agent_whose_node_is_deleted_loses_it_and_one_of_two_keeps_it(late: Stage) -> None:
    late.cluster.machines += [node("node-15", "vehicle-15"), node("node-15b", "vehicle-15")]
    late.go(wake=NODES)
    others = {path for path in late.releases() if "/vehicle-15/" not in path}
    assert set(late.releases()) - others == {"releases/vehicle-15/mqtt-bridge-node-15.yaml"}
    late.cluster.machines = [n for n in late.cluster.machines if n.name != "node-15"]
    late.go(wake=NODES)
    assert set(late.releases()) - others == {"releases/vehicle-15/mqtt-bridge.yaml"}  # one Node left: no Node's name
    late.cluster.machines = [n for n in late.cluster.machines if n.name != "node-15b"]
    late.go(wake=NODES)
    assert "vehicle-15" not in namespaces(late)


def test_a_node_of_an_undeclared_agent_gets_nothing_and_is_reported_once(stage: Stage) -> None:
    before = stage.releases()
    stage.cluster.machines.append(node("node-99", "vehicle-99"))
    stage.cluster.machines.append(NodeState("platform-0", "platform-0", "platform", frozenset(), True))
    stage.go(wake=NODES)
    stage.go(wake=NODES)
    assert stage.releases() == before
    [(name, reason, text)] = stage.cluster.reports
    assert (name, reason) == ("node-99", "UnknownAgent")
    assert "declare it (charts/robotkube, values agents), enroll it where its name is reserved" in text
    assert "or correct the Node's label robotkube.io/agent" in text


def test_reports_that_do_not_arrive_are_made_again_and_bounded(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    stage.cluster.machines += [node(f"node-{i}", f"stranger-{i}") for i in range(EVENTS_AT_ONCE_MAX + 1)]
    report: Callable[[str, str, str], None] = stage.cluster.report_on_node

    def refuse(name: str, reason: str, text: str) -> None:
        raise UnavailableError("API server: away")

    monkeypatch.setattr(stage.cluster, "report_on_node", refuse)
    stage.go(1, wake=NODES)
    assert stage.cluster.reports == []
    monkeypatch.setattr(stage.cluster, "report_on_node", report)
    stage.go(1, wake=NODES)
    assert len(stage.cluster.reports) == EVENTS_AT_ONCE_MAX
    stage.go(1, wake=NODES)
    assert len(stage.cluster.reports) == EVENTS_AT_ONCE_MAX + 1
