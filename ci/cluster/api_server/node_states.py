"""The registered nodes of a cluster: their states, and a table of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ci.cluster.api_server.client import Api
from ci.cluster_contract.provider import NodeState
from ci.cluster_contract.sharing import trial_of
from robotkube.foundation.kubernetes.core.node_agents import node_agents


def nodes(api: Api) -> tuple[NodeState, ...]:
    """All registered nodes, in the order of their addresses."""
    items = api.get("/api/v1/nodes")["items"]
    states = [state for item in items for state in node_states(item)]
    return tuple(sorted(states, key=lambda node: [int(part) for part in node.address.split(".")]))


def node_states(item: Mapping[str, Any]) -> tuple[NodeState, ...]:
    """A Node of the API server, for each of its agents; one that is nobody's once."""
    addresses = {entry["type"]: entry["address"] for entry in item["status"].get("addresses", [])}
    conditions = {entry["type"]: entry["status"] for entry in item["status"].get("conditions", [])}
    return tuple(
        NodeState(
            name=item["metadata"]["name"],
            role=agent.role,
            agent=agent.name,
            address=addresses.get("InternalIP", "0.0.0.0"),  # noqa: S104 - a value to sort by, nothing listens there
            ready=conditions.get("Ready") == "True",
            guest=agent.guest,
        )
        for agent in node_agents(item["metadata"].get("labels", {}))
    )


def nodes_table(states: Sequence[NodeState]) -> str:
    """Nodes as a table of text, and below it whether any is several agents'."""
    rows = [("NODE", "ROLE", "AGENT", "ADDRESS", "READY")]
    table = aligned([*rows, *((n.name, n.role, n.agent, n.address, "yes" if n.ready else "NO") for n in states)])
    return "\n".join(filter(None, (table, trial_of(states))))


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as lines of text, each column as wide as its widest cell."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
