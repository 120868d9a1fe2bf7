"""Agents that share a Node (trial mode): what they are offered of it, where their releases say that they run, and which
charts cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from robotkube.delivery.manager.adapters.kubernetes_cluster import read_nodes
from robotkube.delivery.manager.core.composition.composer import Memo, compose
from robotkube.delivery.manager.core.composition.inputs import Inputs
from robotkube.delivery.manager.core.placement.capacity import Resources
from robotkube.delivery.manager.core.placement.placement import Agent, NodeState, fleet
from robotkube.foundation.kubernetes.core.node_agents import NodeAgent
from tests.stages.delivery.manager.placement import (
    AGENTS,
    NODES,
    ONE,
    PLAIN,
    application,
    catalogue,
    demand,
    inputs,
    places,
    refusal,
    several,
    task,
)

HOST, GUEST = (
    NodeAgent("roadside-0", "roadside", frozenset({"gpu"})),
    NodeAgent("roadside-1", "roadside", frozenset(), 1),
)
PLATFORM = NodeAgent("platform", "platform", frozenset(), 2)
BOUND = {"name": "a", "release": "a-{{ task.name }}", "placement": {"agent": "{{ parameters.agents[0] }}"}}
PLACED = {"type": "object", "properties": {"agent": {}, "movable": {}, "node": {}}, "additionalProperties": False}
KNOWS = {"properties": {"placement": {**PLACED, "properties": {**PLACED["properties"], "guest": {"type": "integer"}}}}}
KNOWS_NOT = {"properties": {"placement": PLACED}}


def shared_node(*agents: NodeAgent) -> dict[str, Any]:
    labels = {key: value for agent in agents for key, value in agent.labels.items()}
    status = {"conditions": [{"type": "Ready", "status": "True"}], "allocatable": {"cpu": "2", "memory": "3Gi"}}
    return {"metadata": {"name": "worker", "labels": labels}, "status": status}


def shared(*agents: NodeAgent) -> tuple[NodeState, ...]:
    return read_nodes(shared_node(*(agents or (HOST, GUEST))))


def known(schema: Mapping[str, Any], nodes: Sequence[NodeState], offered: Any = PLAIN) -> Inputs:
    schemas = _knowing if schema is KNOWS else _knowing_not
    return inputs(offered, nodes, schema=schemas)


def _knowing(chart: str, version: str) -> Mapping[str, Any]:
    return KNOWS


def _knowing_not(chart: str, version: str) -> Mapping[str, Any]:
    return KNOWS_NOT


def test_a_node_is_each_of_its_agents_with_an_equal_part_of_it() -> None:
    """Three agents on two processors are offered two processors, not six."""
    nodes = shared(HOST, GUEST, PLATFORM)
    assert [(node.name, node.agent, node.role, node.guest) for node in nodes] == [
        ("worker", "roadside-0", "roadside", 0),
        ("worker", "roadside-1", "roadside", 1),
        ("worker", "platform", "platform", 2),
    ]
    assert [node.capabilities for node in nodes] == [{"gpu"}, frozenset(), frozenset()]
    assert {node.allocatable for node in nodes} == {Resources(666, 2**30)}
    assert shared(HOST)[0].allocatable == Resources(2000, 3 * 2**30)


def test_what_fits_on_a_node_is_placed_once_however_many_agents_it_is() -> None:
    """The chart asks for half a processor: a Node of two takes four of it, two for each of the two agents."""
    composition = compose(several(5), known(KNOWS, shared()))
    assert (
        sorted(release.namespace for release in composition.releases.values())
        == ["roadside-0"] * 2 + ["roadside-1"] * 2
    )
    assert refusal(composition, "ops/t4").reason == "InsufficientResources"


def test_releases_of_guests_alone_say_so() -> None:
    composition = compose(several(2), known(KNOWS, shared()))
    placements = {release.namespace: release.values["placement"] for release in composition.releases.values()}
    assert placements == {
        "roadside-0": {"agent": "roadside-0", "movable": True},
        "roadside-1": {"agent": "roadside-1", "movable": True, "guest": 1},
    }


def test_a_chart_that_knows_no_guests_goes_to_hosts_and_says_why() -> None:
    composition = compose(several(3), known(KNOWS_NOT, shared()))
    reason = "roadside-1: is a guest on another agent's Node, which worker 0.1.0 knows nothing of"
    assert {release.namespace for release in composition.releases.values()} == {"roadside-0"}
    assert reason in refusal(composition, "ops/t2").message
    bound = catalogue(application(BOUND))
    of_guest = demand(task(parameters={"agents": ["roadside-1"]}))
    outcome = refusal(compose([of_guest], known(KNOWS_NOT, shared(), bound)))
    assert (outcome.reason, reason in outcome.message) == ("NoCapableNode", True)
    assert places(compose([of_guest], known(KNOWS, shared(), bound))) == {"a-t": "roadside-1"}


def test_who_becomes_a_guest_or_a_host_is_written_anew_though_all_was_composed_before() -> None:
    """Only the Node's labels change; what was composed is not taken from before."""
    memo = Memo()
    bound = catalogue(application(BOUND))
    selectors = set()
    demands = [demand(task(parameters={"agents": ["roadside-1"]}))]
    own = replace(NODES[1], name="worker")
    numbers = []
    for nodes in ((own,), shared(), shared(HOST, replace(GUEST, guest=2)), (own,)):
        [release] = compose(demands, known(KNOWS, nodes, bound), memo).releases.values()
        numbers.append(release.values["placement"].get("guest"))
        selectors.add(id(memo.index(known(KNOWS, nodes, bound)).selector))
    assert numbers == [None, 1, 2, None]
    assert len(selectors) == 1, "the memo went on with what it had"


def test_of_an_agents_nodes_only_the_shared_one_has_a_guests_number() -> None:
    own = NodeState("own", "roadside-1", "roadside", frozenset(), True, allocatable=Resources(1000, 2**30))
    agent = Agent("roadside-1", "roadside", "roadside-1")
    of_both = replace(fleet([agent], [*shared(), own]), homes={"roadside-1": "own"})
    assert [(place.node, place.guest) for place in of_both.places(of_both.agents["roadside-1"])] == [
        ("own", 0),
        ("worker", 1),
    ]
    assert of_both.home(of_both.agents["roadside-1"]).guest == 0


def test_where_no_node_is_shared_nothing_of_it_is_written() -> None:
    assert all(agent.guest == 0 for agent in fleet(AGENTS, NODES).agents.values())
    composition = compose(several(3), known(KNOWS_NOT, NODES, catalogue(application(ONE))))
    assert all("guest" not in release.values["placement"] for release in composition.releases.values())
