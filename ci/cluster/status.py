"""Status of a running cluster: nodes, pods that are not ready, and what the cluster's own processes cost."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ci.cluster import cgroups
from ci.cluster.api import Api
from ci.cluster.processes import Process
from ci.cluster.provider import NodeState

MIB = 2**20


def nodes(api: Api) -> tuple[NodeState, ...]:
    """All registered nodes, in the order of their addresses."""
    items = api.get("/api/v1/nodes")["items"]
    states = [node_state(item) for item in items]
    return tuple(sorted(states, key=lambda node: [int(part) for part in node.address.split(".")]))


def node_state(item: Mapping[str, Any]) -> NodeState:
    """A Node of the API server."""
    labels = item["metadata"].get("labels", {})
    addresses = {entry["type"]: entry["address"] for entry in item["status"].get("addresses", [])}
    conditions = {entry["type"]: entry["status"] for entry in item["status"].get("conditions", [])}
    return NodeState(
        name=item["metadata"]["name"],
        role=labels.get("robotkube.io/role", ""),
        agent=labels.get("robotkube.io/agent", ""),
        address=addresses.get("InternalIP", "0.0.0.0"),  # noqa: S104 - a value to sort by, nothing listens there
        ready=conditions.get("Ready") == "True",
    )


def table(cluster: str, api: Api, processes: Sequence[Process]) -> str:
    """Three tables as text: nodes, pods by namespace, processes by program."""
    pods = [("NAMESPACE", "PODS", "NOT READY")]
    pods += _pods(api.get("/api/v1/pods")["items"])
    costs = [("PROGRAM", "PROCESSES", "ENDED", "MEMORY MiB", "CPU SECONDS"), *_costs(cluster, processes)]
    return "\n\n".join([nodes_table(nodes(api)), _aligned(pods), _aligned(costs)])


def nodes_table(states: Sequence[NodeState]) -> str:
    """Nodes as a table of text."""
    rows = [("NODE", "ROLE", "AGENT", "ADDRESS", "READY")]
    return _aligned([*rows, *((n.name, n.role, n.agent, n.address, "yes" if n.ready else "NO") for n in states)])


def _pods(items: Iterable[dict[str, Any]]) -> list[tuple[str, str, str]]:
    total: Counter[str] = Counter()
    waiting: dict[str, list[str]] = {}
    for item in items:
        namespace = item["metadata"]["namespace"]
        total[namespace] += 1
        conditions = {entry["type"]: entry["status"] for entry in item["status"].get("conditions", [])}
        if conditions.get("Ready") != "True" and item["status"].get("phase") != "Succeeded":
            waiting.setdefault(namespace, []).append(item["metadata"]["name"])
    return [(name, str(count), " ".join(waiting.get(name, [])) or "-") for name, count in sorted(total.items())]


def _costs(cluster: str, processes: Sequence[Process]) -> list[tuple[str, ...]]:
    programs: dict[str, list[Process]] = {}
    for process in processes:
        programs.setdefault(process.name.rpartition(".")[2], []).append(process)
    rows: list[tuple[str, ...]] = []
    for program, group in sorted(programs.items()):
        memory = sum(resident_bytes(process.pid) for process in group if process.alive()) / MIB
        cpu = sum(cgroups.cpu_seconds(cluster, process.name) or 0.0 for process in group)
        ended = sum(not process.alive() for process in group)
        rows.append((program, str(len(group)), str(ended), f"{memory:.0f}", f"{cpu:.1f}"))
    return rows


def resident_bytes(pid: int) -> int:
    """Memory of a process that is its own or shared in part (proportional share); 0 if it ended meanwhile."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:")) or os.sysconf("SC_PAGE_SIZE")


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
