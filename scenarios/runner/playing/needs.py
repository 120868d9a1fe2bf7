"""What a scenario needs of a cluster, compared with what the cluster is: its nodes, and what can be done to them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from ci.cluster_contract.provider import NodeState, Provider
from ci.errors import InputError
from scenarios.definition import Node, Scenario
from scenarios.runner.playing.acting import describe
from scenarios.runner.waiting import RunError

PLATFORM = "platform"  # role
OF_MACHINES = ("stop", "start")  # actions of steps


def require_machines(scenario: Scenario, provider: Provider) -> None:
    """InputError names what of the scenario is done to machines of nodes, where the cluster did not make these."""
    needs = of_machines(scenario)
    if needs and provider.machines() is None:
        raise InputError(
            f"scenario {scenario.name} does not run on a cluster of kind {provider.kind}, which did not make its "
            f"machines: {'; '.join(needs)}. Choose another variant, or a cluster that did"
        )


def of_machines(scenario: Scenario) -> list[str]:
    """What the scenario does to machines of nodes and their cables, in words."""
    steps = [f"step {step.name!r} {describe(step)}" for step in scenario.steps if step.action in OF_MACHINES]
    return [*steps, *(f"network gives the cable of {agent} conditions" for agent in scenario.network)]


def nodes_by_name(scenario: Scenario, provider: Provider) -> Mapping[str, str]:
    """The cluster's node for each node of the scenario, by name: of the same agent, or the platform's as well, and
    ready. RunError names those that are not there: the run would wait for players that cannot exist."""
    ready: dict[str, list[NodeState]] = defaultdict(list)
    for node in provider.nodes():
        if node.ready:
            ready[_owner(node)].append(node)
    nodes = {wanted.name: _taken(wanted.name, ready[_owner(wanted)]) for wanted in scenario.nodes}
    missing = [name for name, node in nodes.items() if not node]
    if missing:
        raise RunError(
            f"cluster {provider.name} has no ready node {', '.join(missing)}; start it with the same --set "
            "vehicles=..., or give the run the number of vehicles that the cluster has"
        )
    return nodes


def _owner(node: NodeState | Node) -> str:
    """Whose a node is; the platform is nobody's namespace, so its agent may have any name."""
    return "" if node.role == PLATFORM else node.agent


def _taken(wanted: str, ready: list[NodeState]) -> str:
    """Take the node of this name, else the first; empty when there is none."""
    same = next((node for node in ready if node.name == wanted), None)
    taken = same or (ready[0] if ready else None)
    if taken is None:
        return ""
    ready.remove(taken)
    return taken.name
