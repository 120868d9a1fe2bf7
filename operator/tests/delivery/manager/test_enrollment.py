"""A vehicle that main enrolls in mid-run: it takes part in the use case, and is out of it when main withdraws it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from robotkube.delivery.deployment.core.policies.agents import PATH
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.core.placement.scopes import DeclaredManager, Operators, Scope
from robotkube.delivery.manager.loops.reconciler import DEPLOYMENT
from robotkube.errors import InputError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS
from tests.stages.delivery.manager.manager_in_memory import Stage

NEW = "vehicle-16"
ENROLLED = {PATH: f"agents: [{{name: {NEW}, role: vehicle}}]\n"}


def with_reserved(folder: Path) -> Stage:
    """A manager whose settings reserve an agent, whose Node is there already."""
    stage = Stage(folder)
    stage.settings = replace(stage.settings, agents=(*stage.settings.agents, Agent(NEW, "", NEW)))
    stage.cluster.machines.append(NodeState(NEW, NEW, "vehicle", frozenset(), True))
    stage.manager = stage.start()
    stage.settle()
    return stage


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return with_reserved(tmp_path)


def people(stage: Stage, files: dict[str, str | None]) -> None:
    stage.repository.push(files, "policy(agents): changed")
    stage.go(8, seconds=RESYNC_SECONDS, wake=DEPLOYMENT)
    stage.cluster.settle(stage.releases())


def namespaces(stage: Stage, task: str = "") -> set[str]:
    """The namespaces with releases; of those alone that the task asks for."""
    releases = stage.releases().values()
    return {release.namespace for release in releases if not task or task in {cause.task for cause in release.causes}}


def test_a_vehicle_enrolled_in_mid_run_takes_part(stage: Stage) -> None:
    task = stage.ask(vehicles=("vehicle-00", NEW))
    stage.settle()
    assert stage.tasks.condition(task, "Accepted")[0] == "False"
    assert NEW not in namespaces(stage)
    people(stage, ENROLLED)
    assert stage.tasks.condition(task, "Accepted")[0] == "True"
    assert {"vehicle-00", NEW, "cloud-0"} <= namespaces(stage, task)


def test_a_withdrawn_vehicle_is_out_of_it(stage: Stage) -> None:
    people(stage, ENROLLED)
    task = stage.ask(vehicles=("vehicle-00", NEW))
    stage.settle()
    assert NEW in namespaces(stage)
    people(stage, {PATH: "agents: []\n"})
    assert NEW not in namespaces(stage)
    assert namespaces(stage, task) == set()
    assert stage.tasks.condition(task, "Accepted")[0] == "False"


def test_releases_of_a_withdrawn_agent_go_in_a_narrow_scope_too(stage: Stage) -> None:
    own = frozenset({"vehicle-00", "cloud-0", NEW})
    one = DeclaredManager("manager", Scope(own, own))
    stage.settings = replace(stage.settings, operators=Operators(one.scope, {}, (one,)))
    stage.manager = stage.start()
    people(stage, ENROLLED)
    stage.ask(vehicles=("vehicle-00", NEW))
    stage.settle()
    assert NEW in namespaces(stage)
    people(stage, {PATH: None})
    assert NEW not in namespaces(stage)


def test_a_node_of_who_is_not_enrolled_is_reported_with_the_way_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stage = with_reserved(tmp_path)
    assert f"unknown agent node={NEW} agent={NEW}" in caplog.text
    assert {agent.name for agent in stage.manager.planner.agents} == {
        "vehicle-00",
        "vehicle-01",
        "vehicle-02",
        "cloud-0",
    }
    people(stage, ENROLLED)
    assert NEW in {agent.name for agent in stage.manager.planner.agents}


def test_a_broken_file_withdraws_nobody(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    people(stage, ENROLLED)
    stage.ask(vehicles=("vehicle-00", NEW))
    stage.settle()
    people(stage, {PATH: "agents: vehicle-16\n"})
    assert NEW in namespaces(stage)
    assert "policy not accepted" in caplog.text
    stage.manager = stage.start()  # which never read a good one: it changes nothing
    with pytest.raises(InputError, match="agents: must be a list"):
        stage.manager.step()
    assert NEW in namespaces(stage)
