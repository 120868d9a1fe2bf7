"""A node's outage: its machine ends at once, with everything on it, and comes back later.

Its namespaces stay, held by their own process, so that it comes back under its name and address, with its files.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from ci.cluster.embedded.host import processes
from ci.cluster.embedded.host.processes import KILL_TIMEOUT_SECONDS, PAUSE_SECONDS, Launcher, Process
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.nodes.node_processes import ALONE, socket_of
from ci.errors import SetUpError
from ci.machine import cgroups

CONTAINERD = "containerd"
DAEMONS = (CONTAINERD, "kubelet", "kube-proxy")  # in the order in which they start
SOCKET_SECONDS_MAX = 30


def stop(cluster: str, node: str) -> None:
    """Kill the node's daemons and pods, again until none is found; nothing to do is fine. SetUpError when something
    outlives the bound, or when there is no such node."""
    names = tuple(process.name for process in _daemons(ClusterFolders(cluster), node))
    deadline = time.monotonic() + KILL_TIMEOUT_SECONDS
    nodes = ClusterFolders(cluster).nodes
    while pids := cgroups.processes_of_node(cluster, node, names) | processes.in_containers(nodes, node):
        if time.monotonic() > deadline:
            raise SetUpError(f"node {node}: processes {sorted(pids)} outlived SIGKILL for {KILL_TIMEOUT_SECONDS} s")
        for pid in pids:
            _kill(pid)
        time.sleep(PAUSE_SECONDS)


def start(cluster: str, node: str) -> None:
    """Start the daemons as they were started before; those that run stay. The node is Ready some seconds later."""
    folders = ClusterFolders(cluster)
    for process in _daemons(folders, node):
        if not process.alive():
            _start(folders, node, process)


def _start(folders: ClusterFolders, node: str, process: Process) -> None:
    launcher = Launcher(folders, _program(process).parent)
    if not process.name.endswith(CONTAINERD):
        launcher.start(process.name, process.command, environment=ALONE)
        return
    socket = socket_of(_recorded(folders, f"{node}.node"))
    socket.unlink(missing_ok=True)  # of the one that was killed
    again = launcher.start(process.name, process.command, environment=ALONE)
    processes.wait_until(socket.exists, CONTAINERD, SOCKET_SECONDS_MAX, [again])


def _program(process: Process) -> Path:
    """The daemon's own program, behind the words that enter the node."""
    return next(path for path in map(Path, process.command) if path.name in DAEMONS)


def _daemons(folders: ClusterFolders, node: str) -> list[Process]:
    return [_recorded(folders, f"{node}.{daemon}") for daemon in DAEMONS]


def _recorded(folders: ClusterFolders, name: str) -> Process:
    recorded = next((process for process in processes.recorded(folders) if process.name == name), None)
    if recorded is None:
        raise SetUpError(f"cluster {folders.name} has no process {name}; name a node of its topology")
    return recorded


def _kill(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return  # ended meanwhile
