"""Whose a Node is, by its labels: one agent's, and in trial mode that of guests beside it (decision 0082).

    robotkube.io/agent: vehicle-00                       the host, with its role and capabilities
    robotkube.io/role: vehicle
    robotkube.io/capability.lidar: "true"
    agent.robotkube.io/vehicle-01: "1"                   a guest with its number, and its role and capabilities
    role.robotkube.io/vehicle-01: vehicle
    lidar.capability.robotkube.io/vehicle-01: "true"

A guest's number is the ROS domain of its pods, since they share the Node's network with those of others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

AGENT, ROLE, CAPABILITY = "robotkube.io/agent", "robotkube.io/role", "robotkube.io/capability."
GUEST, GUEST_ROLE, GUEST_CAPABILITY = "agent.robotkube.io/", "role.robotkube.io/", ".capability.robotkube.io/"
GUESTS_MAX = 80  # the ROS domains from 88 on are those of charts that are tried
TRUE = "true"
TRIAL_MEANS = "no machine keeps them apart, and no figure compares machines"


@dataclass(frozen=True)
class NodeAgent:
    """One of those whose a Node is. `guest` is its number, 0 that of the host."""

    name: str
    role: str
    capabilities: frozenset[str] = frozenset()
    guest: int = 0

    @property
    def labels(self) -> dict[str, str]:
        """What makes a Node this one's."""
        if not self.guest:
            named = {ROLE: self.role, AGENT: self.name}
            return named | {f"{CAPABILITY}{capability}": TRUE for capability in sorted(self.capabilities)}
        named = {**selector(self.name, self.guest), f"{GUEST_ROLE}{self.name}": self.role}
        return named | {f"{one}{GUEST_CAPABILITY}{self.name}": TRUE for one in sorted(self.capabilities)}


def selector(agent: str, guest: int) -> dict[str, str]:
    """The labels by which the pods of an agent choose its Node."""
    return {f"{GUEST}{agent}": str(guest)} if guest else {AGENT: agent}


def node_agents(labels: Mapping[str, str]) -> tuple[NodeAgent, ...]:
    """Those whose a Node is: the host, also one without a name, then the guests by their numbers."""
    of_host = (key.removeprefix(CAPABILITY) for key, value in labels.items() if _is_capability(key, value))
    host = NodeAgent(labels.get(AGENT, ""), labels.get(ROLE, ""), frozenset(of_host))
    guests = [_guest(key.removeprefix(GUEST), labels) for key in labels if key.startswith(GUEST)]
    return (host, *sorted((guest for guest in guests if guest.guest), key=lambda one: (one.guest, one.name)))


def _is_capability(key: str, value: str) -> bool:
    return key.startswith(CAPABILITY) and value == TRUE


def _guest(name: str, labels: Mapping[str, str]) -> NodeAgent:
    """The guest of that name; number 0 where its label has none that can be a guest's."""
    end = f"{GUEST_CAPABILITY}{name}"
    capabilities = (key.removesuffix(end) for key, value in labels.items() if key.endswith(end) and value == TRUE)
    word = labels[f"{GUEST}{name}"]
    number = int(word) if word.isascii() and word.isdecimal() and int(word) <= GUESTS_MAX else 0
    return NodeAgent(name, labels.get(f"{GUEST_ROLE}{name}", ""), frozenset(capabilities), number)


def shared_nodes(nodes: Iterable[tuple[str, Mapping[str, str]]]) -> dict[str, Sequence[str]]:
    """The names of the agents of each Node (name and labels) that is several agents'."""
    agents_of = {name: [agent.name for agent in node_agents(labels) if agent.name] for name, labels in nodes}
    return {name: agents for name, agents in sorted(agents_of.items()) if len(agents) > 1}


def trial_words(shared: Mapping[str, Sequence[str]]) -> str:
    """What has to be said where Nodes are several agents'; empty where none is."""
    if not shared:
        return ""
    nodes = "; ".join(f"Node {node} is {', '.join(agents)}" for node, agents in shared.items())
    return f"trial mode: agents share Nodes ({nodes}), so {TRIAL_MEANS}"
