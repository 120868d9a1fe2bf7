"""Nodes of undeclared agents: nothing is placed on them, and it is reported."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from robotkube.delivery.manager.core.placement.placement import Agent, NodeState
from robotkube.delivery.manager.core.placement.scopes import unknown_nodes
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.errors import RobotKubeError

UNKNOWN_AGENT = "UnknownAgent"
EVENTS_AT_ONCE_MAX = 10  # Events of one resync; the others follow with the next ones

log = logging.getLogger(__name__)


class UnknownAgents:
    """The reports about such Nodes: once for each, in the log and as an Event, with what to do. `agents` gives those
    that are there."""

    def __init__(self, cluster: Cluster, agents: Callable[[], Iterable[Agent]]) -> None:
        self._cluster = cluster
        self._agents = agents
        self._reported: set[tuple[str, str]] = set()

    def resync(self) -> tuple[NodeState, ...]:
        """Report new Nodes of undeclared agents, at most EVENTS_AT_ONCE_MAX at once, and return all that are there now.
        What the API server does not accept is tried again with the next resync."""
        unknown = unknown_nodes(self._cluster.nodes(), {agent.name for agent in self._agents()})
        self._reported &= {(node.name, node.agent) for node in unknown}
        for node in [n for n in unknown if (n.name, n.agent) not in self._reported][:EVENTS_AT_ONCE_MAX]:
            self._report(node)
        return unknown

    def _report(self, node: NodeState) -> None:
        text = (
            f"Node {node.name} says it is agent {node.agent!r}, which is not declared, so nothing is placed on it: "
            "declare it (charts/robotkube, values agents), enroll it where its name is reserved (robotkube agent "
            "enroll), or correct the Node's label robotkube.io/agent (of a guest: agent.robotkube.io/NAME)"
        )
        try:
            self._cluster.report_on_node(node.name, UNKNOWN_AGENT, text)
        except RobotKubeError as error:
            log.error("event not written node=%s reason=%s", node.name, error)
            return
        log.warning("unknown agent node=%s agent=%s", node.name, node.agent)
        self._reported.add((node.name, node.agent))
