"""Status of a running cluster: nodes, pods that are not ready, and what the cluster's own processes cost."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ci.cluster.api_server.client import Api
from ci.cluster.api_server.node_states import aligned, nodes, nodes_table
from ci.cluster.embedded.host.processes import Process
from ci.machine import cgroups

MIB = 2**20


def table(cluster: str, api: Api, processes: Sequence[Process]) -> str:
    """Three tables as text: nodes, pods by namespace, processes by program."""
    pods = [("NAMESPACE", "PODS", "NOT READY")]
    pods += _pods(api.get("/api/v1/pods")["items"])
    costs = [("PROGRAM", "PROCESSES", "ENDED", "MEMORY MiB", "CPU SECONDS"), *_costs(cluster, processes)]
    return "\n\n".join([nodes_table(nodes(api)), aligned(pods), aligned(costs)])


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
