"""What runc wrote down of a node's containers: their first processes and control groups. No record of the cluster has
those of containers that somebody started beside the kubelet, and they are to end with their node, too.

    <node>/run/containerd/runc/<namespace>/<id>/state.json
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ci.machine import cgroups

STATES = "run/containerd/runc/*/*/state.json"


def first_processes(nodes: Path, node: str = "*") -> set[tuple[int, int]]:
    """Pid and start (field 22 of /proc/<pid>/stat) of the first process of each container, of one node or of all in a
    folder. Where it is another process by now, the container has ended; with the first one all others end."""
    numbers = {(state.get("init_process_pid"), state.get("init_process_start")) for state in _states(nodes, node)}
    return {(pid, start) for pid, start in numbers if isinstance(pid, int) and isinstance(start, int)}


def foreign_groups(nodes: Path, cluster: str) -> tuple[Path, ...]:
    """Control groups of containers that are in none of the cluster's own."""
    paths = {Path(str(path)) for state in _states(nodes, "*") for path in (state.get("cgroup_paths") or {}).values()}
    places = cgroups.hierarchies()
    own = [place / cgroups.top(cluster) for place in places]
    below = {path for path in paths if any(path != place and path.is_relative_to(place) for place in places)}
    return tuple(sorted(path for path in below if path.is_dir() and not any(map(path.is_relative_to, own))))


def _states(nodes: Path, node: str) -> Iterator[dict[str, Any]]:
    for path in nodes.glob(f"{node}/{STATES}"):
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue  # it is being written, or has gone
        if isinstance(document, dict):
            yield document
