"""Programs of this project that follow a cluster from its host: started with it, and again when they end."""

from __future__ import annotations

import os
import sys

from ci.cluster.node_processes import AGAIN
from ci.cluster.processes import Launcher, Process
from ci.cluster.records import ClusterFolders
from ci.folders import PROJECT

STARTED_AGAIN = ("/bin/sh", "-c", AGAIN, "again")


def start(launcher: Launcher, name: str, module: str, weight: int | None = None) -> Process:
    """Start a module as the cluster's process of that name. `weight`: see `cgroups`."""
    return launcher.start(name, command(module, launcher.folders), STARTED_AGAIN, environment(), weight)


def command(module: str, folders: ClusterFolders) -> list[str]:
    """The words that run a module once for a cluster."""
    return [sys.executable, "-m", module, "--name", folders.name]


def environment() -> dict[str, str]:
    """Where a module finds this project and the user's cache."""
    path = os.pathsep.join(str(PROJECT / part) for part in ("operator/src", "."))
    cache = {name: os.environ[name] for name in ("HOME", "XDG_CACHE_HOME") if name in os.environ}
    return {**cache, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}
