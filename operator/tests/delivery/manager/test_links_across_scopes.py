"""Links between agents of two managers: composed where both scopes consent on main, and gone when one does no more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotkube.delivery.deployment.core.policies.links import path_of
from robotkube.delivery.gate.core.proposal_checks import Proposer
from robotkube.delivery.gate.loops.rules import GateRules, GateSettings
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.core.placement.scopes import DeclaredManager, Operators, Scope
from robotkube.delivery.manager.loops.reconciler import DEPLOYMENT
from robotkube.foundation.documents.adapters.json_schema import validate
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from robotkube.foundation.forge.ports.repositories import Commit
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.testing.clusters import MemoryTasks
from tests.stages.attacks import shown
from tests.stages.delivery.manager.manager_in_memory import CHARTS, Stage

SOUTH = frozenset({"vehicle-00", "vehicle-01", "cloud-0"})
NORTH = frozenset({"vehicle-02", "cloud-1"})
MANAGERS = (DeclaredManager("south", Scope(SOUTH, SOUTH)), DeclaredManager("north", Scope(NORTH, NORTH)))
TOPICS = [f"/vehicles/{{agent}}/{name}" for name in ("pose", "lidar_center/pointcloud", "lidar_center/transform")]
SENDS = {path_of("south"): f"sends: [{{to: north, topics: {TOPICS}}}]\n"}
RECEIVES = {path_of("north"): f"receives: [{{from: south, topics: {TOPICS}}}]\n"}
POSE = "/vehicles/vehicle_00/pose"
CLOUD = "/vehicles/vehicle_00/lidar_center/pointcloud"
TASK = "cloud-1/meeting"


def scoped(stage: Stage, manager: DeclaredManager) -> Stage:
    """The stage's manager begins anew as this one."""
    stage.settings = replace(stage.settings, operators=Operators(manager.scope, {}, MANAGERS))
    stage.tasks.namespaces = manager.scope.namespaces
    stage.manager = stage.start()
    return stage


class Neighbours:
    """The managers of the south and the north, on one stage; `asked` for a recording of vehicles of both."""

    def __init__(self, folder: Path) -> None:
        self.south = Stage(folder / "south")
        agents = (*self.south.settings.agents, Agent("cloud-1", "cloud", "cloud-1"))
        self.south.settings = replace(self.south.settings, agents=agents)
        self.south.cluster.machines.append(NodeState("cloud-1", "cloud-1", "cloud", frozenset({"recording"}), True))
        self.north = Stage(folder / "north")
        for part in ("settings", "verifier", "catalogue", "cluster", "repository", "forge"):
            setattr(self.north, part, getattr(self.south, part))
        self.north.tasks = MemoryTasks(self.south.tasks.objects)
        scoped(self.south, MANAGERS[0]).settle()
        scoped(self.north, MANAGERS[1]).settle()

    def people(self, files: Mapping[str, str | None]) -> None:
        """People merge these files, and both managers do what they have to."""
        self.south.repository.push(files, "policy(links): agreed")
        self.go()

    def go(self) -> None:
        for _ in range(2):
            for stage in (self.north, self.south):
                stage.go(6, seconds=RESYNC_SECONDS, wake=DEPLOYMENT)

    def ask(self) -> None:
        self.north.ask("meeting")
        task = self.north.tasks.objects.pop("cloud-0/meeting")
        task["metadata"]["namespace"] = "cloud-1"
        task["spec"]["parameters"] = {"vehicles": ["vehicle-02", "vehicle-00"]}
        self.north.tasks.objects[TASK] = task
        self.go()

    def accepted(self) -> tuple[str, str]:
        condition: tuple[str, str] = self.north.tasks.condition(TASK, "Accepted")
        return condition

    def message(self) -> str:
        conditions = self.north.tasks.objects[TASK]["status"]["conditions"]
        return str(next(c["message"] for c in conditions if c["type"] == "Accepted"))

    def topics(self, agent: str, direction: str) -> set[str]:
        release = self.north.releases().get(f"releases/{agent}/mqtt-bridge.yaml")
        items: list[Mapping[str, Any]] = release.values["bridge"][direction] if release else []
        return {item["name"] for item in items}


@pytest.fixture
def neighbours(tmp_path: Path) -> Neighbours:
    return Neighbours(tmp_path)


def test_a_link_over_a_border_is_refused_without_the_consent_of_both(neighbours: Neighbours) -> None:
    neighbours.ask()
    assert neighbours.accepted() == ("False", "LinkNotConsented")
    said = neighbours.message()
    shown("selection", said, "heard-over-a-border")
    assert "vehicle-00 of scope south, and cloud-1 is of scope north" in said
    assert f"{path_of('south')} sends: " in said
    assert f"{path_of('north')} receives: " in said
    neighbours.people(SENDS)
    assert neighbours.accepted() == ("False", "LinkNotConsented")
    assert f"{path_of('south')} sends: " not in neighbours.message()
    assert "releases/cloud-1/recorder-vehicle-02-vehicle-00.yaml" not in neighbours.north.releases()


def test_with_the_consent_of_both_each_manager_writes_its_own_end(neighbours: Neighbours) -> None:
    neighbours.people({**SENDS, **RECEIVES})
    before = neighbours.topics("vehicle-00", "out")
    assert CLOUD not in before
    neighbours.ask()
    assert neighbours.accepted()[0] == "True"
    assert {POSE, CLOUD} <= neighbours.topics("cloud-1", "in")
    assert {POSE, CLOUD} <= neighbours.topics("vehicle-00", "out"), "by the manager of the south"
    tip = neighbours.south.repository.tip
    neighbours.go()
    assert neighbours.south.repository.tip == tip, "neither undoes what the other wrote"
    neighbours.north.tasks.delete(TASK)
    neighbours.go()
    assert neighbours.topics("vehicle-00", "out") == before
    assert CLOUD not in neighbours.topics("cloud-1", "in")


@pytest.mark.parametrize("scope", ["south", "north"])
def test_a_consent_that_is_withdrawn_ends_the_link(neighbours: Neighbours, scope: str) -> None:
    neighbours.people({**SENDS, **RECEIVES})
    before = neighbours.topics("vehicle-00", "out")
    neighbours.ask()
    assert CLOUD in neighbours.topics("cloud-1", "in")
    neighbours.people({path_of(scope): None})
    assert neighbours.accepted() == ("False", "LinkNotConsented")
    assert CLOUD not in neighbours.topics("cloud-1", "in")
    assert neighbours.topics("vehicle-00", "out") == before
    neighbours.people({**SENDS, **RECEIVES})
    assert neighbours.accepted()[0] == "True", "and with the consent it comes back"


def test_the_gate_reads_consents_from_main(neighbours: Neighbours) -> None:
    """Who may touch what is in its settings, what may pass between them on main alone."""
    north = neighbours.north
    proposers = tuple(Proposer(manager.name, manager.scope.agents) for manager in MANAGERS)
    settings = GateSettings("gate", "robotkube/deployment", "robotkube/catalogue", proposers, CHARTS)
    catalogue = AssuredCatalogue(north.catalogue, north.verifier)
    rules = GateRules(settings, north.repository, catalogue, validate, lambda *_: ())
    neighbours.people({**SENDS, **RECEIVES})
    neighbours.ask()
    path = "releases/cloud-1/mqtt-bridge.yaml"
    text = north.repository.files(north.repository.tip, ("releases",))[path] + "# edited\n"

    def problems() -> str:
        tip = north.repository.tip
        commit = Commit("c" * 40, (tip,), "Edit\n", "operator-team", {path: text})
        return "\n".join(rules.judge("operator-team", rules.proposal(commit)).problems)

    assert problems() == ""
    north.repository.push({path_of("north"): None}, "policy(links): no more")
    assert f"topic {POSE} is said by vehicle-00 of scope south" in problems()
    assert f"main lacks {path_of('north')} receives: " in problems()
    north.repository.push({path_of("north"): "receives: 7"}, "policy(links): broken")
    assert f"main lacks {path_of('north')} receives: " in problems()
