"""What a scenario needs of a cluster: nodes of its agents, and machines that may be stopped."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from ci.cluster_contract.provider import NodeState
from ci.errors import InputError
from scenarios import definition
from scenarios.runner import waiting
from scenarios.runner.playing import needs
from scenarios.steps import Step, read_steps
from tests.stages.paths import SCENARIOS

FOLDER = SCENARIOS / "pose-point-cloud-db-recording"


@pytest.fixture
def scenario() -> definition.Scenario:
    return definition.load(FOLDER, variant="small")


def test_nodes_of_other_names_are_those_of_the_same_agents(scenario: definition.Scenario) -> None:
    def state(name: str, agent: str, ready: bool = True) -> NodeState:
        return NodeState(name, "platform" if agent == "platform" else "", agent, "", ready)

    agents = ["platform" if node.role == "platform" else node.agent for node in scenario.nodes]
    there = [state(f"machine-{number}", agent) for number, agent in enumerate(agents)]
    other = SimpleNamespace(name="theirs", nodes=lambda: there)
    names = needs.nodes_by_name(scenario, other)  # type: ignore[arg-type]
    assert names == {node.name: f"machine-{number}" for number, node in enumerate(scenario.nodes)}
    there[0] = replace(there[0], ready=False)
    with pytest.raises(waiting.RunError, match=f"cluster theirs has no ready node {scenario.nodes[0].name};"):
        needs.nodes_by_name(scenario, other)  # type: ignore[arg-type]
    agent = scenario.nodes[-1].agent
    two = replace(scenario, nodes=tuple(replace(scenario.nodes[-1], name=name) for name in ("one", "two")))
    there[:] = [state("two", agent), state("one", agent)]
    assert needs.nodes_by_name(two, other) == {"one": "one", "two": "two"}  # type: ignore[arg-type]
    del there[1]
    with pytest.raises(waiting.RunError, match="has no ready node"):
        needs.nodes_by_name(two, other)  # type: ignore[arg-type]


STOPPED = read_steps([{"name": "the cloud is lost", "do": {"stop": "cloud-0"}}])


@pytest.mark.parametrize(
    ("variant", "steps", "named"),
    [
        ("mobile-network", (), "network gives the cable of vehicle-00 conditions; "),
        ("small", STOPPED, r"step 'the cloud is lost' stops node cloud-0\. Choose another variant"),
    ],
)
def test_a_scenario_that_needs_machines_is_refused_where_they_are_others(
    variant: str, steps: tuple[Step, ...], named: str
) -> None:
    settled = replace(definition.load(FOLDER, variant=variant), steps=steps)
    others: Any = SimpleNamespace(kind="other", machines=lambda: None)
    with pytest.raises(InputError, match=f"does not run on a cluster of kind other, which did not make .*: {named}"):
        needs.require_machines(settled, others)
    needs.require_machines(settled, SimpleNamespace(kind="own", machines=lambda: others))  # type: ignore[arg-type]
    needs.require_machines(replace(settled, steps=(), network={}), others)
