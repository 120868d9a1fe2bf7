"""Nodes that are several agents' (trial mode, decision 0082): who of them is the host, what labels that makes, and what
has to be said of it. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ci.cluster_contract.provider import NodeState
from ci.cluster_contract.topology import AgentOfNode
from ci.errors import InputError
from robotkube.foundation.kubernetes.core.node_agents import (
    GUESTS_MAX,
    NodeAgent,
    node_agents,
    selector,
    trial_words,
)

PLATFORM = "platform"
HOSTS = {"cloud": 0, PLATFORM: 2}  # charts are tried on the first cloud, and nobody's chart runs on the platform
OTHER = 1


def numbered(members: Sequence[AgentOfNode]) -> tuple[NodeAgent, ...]:
    """Those of one Node, the host first, and the guests with their numbers; InputError when there are too many."""
    if len(members) > GUESTS_MAX + 1:
        raise InputError(f"{len(members)} agents on one Node; {GUESTS_MAX + 1} can share one, take more Nodes")
    ordered = sorted(members, key=lambda one: HOSTS.get(one.role, OTHER))
    return tuple(
        NodeAgent(one.agent, one.role, frozenset(one.capabilities), number) for number, one in enumerate(ordered)
    )


def labels(members: Sequence[AgentOfNode]) -> dict[str, str]:
    """The labels of the Node of these."""
    return {key: value for one in numbered(members) for key, value in one.labels.items()}


def platform_values(nodes: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """Values of the platform's chart that say where its pods run, when the platform is a guest by the labels of Nodes
    (by name); nothing when it is none. InputError where it would have to be chosen by two labels."""
    of_platform = [(name, agent) for name, has in nodes.items() for agent in node_agents(has) if agent.role == PLATFORM]
    if not any(one.guest for _, one in of_platform):
        return {}
    if len(of_platform) > 1:
        names = ", ".join(sorted(name for name, _ in of_platform))
        raise InputError(f"Nodes {names} are of role platform; where it shares a Node with agents it has one alone")
    [(_, one)] = of_platform
    return {"platform": {"nodeSelector": selector(one.name, one.guest)}}


def trial_of(states: Iterable[NodeState]) -> str:
    """What has to be said of these Nodes; empty where each is one agent's."""
    agents: dict[str, list[str]] = {}
    for state in states:
        agents.setdefault(state.name, []).append(state.agent)
    return trial_words({name: of_node for name, of_node in sorted(agents.items()) if len(of_node) > 1})
