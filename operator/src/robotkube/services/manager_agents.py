"""Nodes that claim an agent which nobody declared: nothing is placed on them, and somebody has to hear of it."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from robotkube.domain.errors import RobotKubeError
from robotkube.domain.placement import Agent, NodeState
from robotkube.domain.scopes import unknown_nodes
from robotkube.ports.clusters import Cluster

UNKNOWN_AGENT = "UnknownAgent"
TOLD_AT_ONCE_MAX = 10  # Events of one look; the others follow with the next ones

log = logging.getLogger(__name__)


class UnknownAgents:
    """Says of every such Node once what to do: in the log, and as an Event."""

    def __init__(self, cluster: Cluster, agents: Sequence[Agent]) -> None:
        self._cluster, self._names = cluster, frozenset(agent.name for agent in agents)
        self._told: set[tuple[str, str]] = set()

    def look(self) -> tuple[NodeState, ...]:
        """The Nodes of undeclared agents that are there now; new ones are told, at most TOLD_AT_ONCE_MAX at once. What
        the API server does not take is tried again with the next look."""
        found = unknown_nodes(self._cluster.nodes(), self._names)
        self._told &= {(node.name, node.agent) for node in found}
        for node in [n for n in found if (n.name, n.agent) not in self._told][:TOLD_AT_ONCE_MAX]:
            self._tell(node)
        return found

    def _tell(self, node: NodeState) -> None:
        text = (
            f"Node {node.name} says it is agent {node.agent!r}, which is not declared, so nothing is placed on it: "
            "declare it (charts/robotkube, values agents), or correct the Node's label robotkube.io/agent"
        )
        try:
            self._cluster.tell_node(node.name, UNKNOWN_AGENT, text)
        except RobotKubeError as error:
            log.error("event not written node=%s reason=%s", node.name, error)
            return
        log.warning("unknown agent node=%s agent=%s", node.name, node.agent)
        self._told.add((node.name, node.agent))
