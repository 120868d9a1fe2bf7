"""Nodes that are several agents' (trial mode), as preflight sees them: that it is so, and labels that do not fit."""

from __future__ import annotations

from typing import Any

from robotkube.delivery.preflight.core.checks import CHECKS
from robotkube.delivery.preflight.core.findings import FAILED, OK, ClusterFinding
from robotkube.foundation.kubernetes.core.node_agents import NodeAgent
from tests.stages.delivery.preflight.preflight_facts import AGENTS, facts, node

NODES = [node(name, role) for name, role in AGENTS.items()]


def with_guests(host: Any, *names: str) -> Any:
    """The Node of a host with these guests, all of them vehicles."""
    labels = dict(host["metadata"]["labels"])
    for number, name in enumerate(names, 1):
        labels |= NodeAgent(name, "vehicle", frozenset(), number).labels
    return {**host, "metadata": {**host["metadata"], "labels": labels}, "spec": dict(host["spec"])}


def finding(check: str, **changed: Any) -> ClusterFinding:
    return next(one for one in CHECKS if one.name == check).finding(facts(**changed))


def said(found: ClusterFinding) -> str:
    """Everything that a failed check says of its problems."""
    assert found.result == FAILED, found
    return "\n".join(f"{problem.where}: {problem.what} -> {problem.fix}" for problem in found.problems)


def test_agents_that_share_a_node_have_one_and_that_is_said() -> None:
    judged = finding("agents", nodes=[with_guests(NODES[0], "vehicle-01"), NODES[2]])
    assert (judged.result, judged.says.partition(";")[2]) == (
        OK,
        " trial mode: agents share Nodes (Node vehicle-00 is vehicle-00, vehicle-01), so no machine keeps them apart, "
        "and no figure compares machines",
    )
    assert "trial mode" not in finding("agents").says


def test_a_guest_of_nobody_of_another_role_or_of_the_suites() -> None:
    words = said(finding("agents", nodes=[with_guests(NODES[0], "vehicle-01", "cloud-0", "stray")]))
    assert "label agent.robotkube.io/stray=3 names no agent of the values" in words
    assert "kubectl label node vehicle-00 agent.robotkube.io/stray-" in words
    assert "label role.robotkube.io/cloud-0 is vehicle, the values say cloud" in words
    assert "agent cloud-0, on which charts are tried, is a guest there -> name a host in suites.agent" in words


def test_numbers_and_capabilities_of_guests_that_do_not_count() -> None:
    shared = with_guests(NODES[0], "vehicle-01", "cloud-0")
    labels = shared["metadata"]["labels"]
    labels |= {"agent.robotkube.io/cloud-0": "1", "lidar.capability.robotkube.io/vehicle-01": "yes"}
    words = said(finding("agents", nodes=[shared]))
    assert "label agent.robotkube.io/vehicle-01 is '1'" in words, "the ROS domain of two"
    assert "kubectl label node vehicle-00 agent.robotkube.io/cloud-0=N --overwrite, N from 1 to 80" in words
    assert "kubectl label node vehicle-00 lidar.capability.robotkube.io/vehicle-01=true" in words
    labels["agent.robotkube.io/cloud-0"] = "no number"
    assert "label agent.robotkube.io/cloud-0 is 'no number'" in said(finding("agents", nodes=[shared]))


def test_a_node_of_several_that_is_not_ready_is_one_problem() -> None:
    shared = with_guests(NODES[0], "vehicle-01", "cloud-0")
    shared["spec"]["unschedulable"] = True
    assert len(finding("agents-ready", nodes=[shared]).problems) == 1
