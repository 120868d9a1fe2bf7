"""Programs of this project that follow a cluster from its host: started with it, and again when they end."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from ci.cluster.embedded.host.processes import AGAIN, Launcher, Process
from ci.cluster.embedded.host.records import ClusterFolders, write_atomically
from ci.folders import PROJECT

R = TypeVar("R")
STARTED_AGAIN = ("/bin/sh", "-c", AGAIN, "again")


def start(launcher: Launcher, name: str, module: str, weight: int | None = None) -> Process:
    """Start a module as the cluster's process of that name. `weight`: see `cgroups`."""
    return launcher.start(name, command(module, launcher.folders), STARTED_AGAIN, environment(), weight)


def command(module: str, folders: ClusterFolders) -> list[str]:
    """The words that run a module once for a cluster."""
    return [sys.executable, "-m", module, "--name", folders.name]


def environment() -> dict[str, str]:
    """The environment in which a module finds this project and the user's cache."""
    path = os.pathsep.join(str(PROJECT / part) for part in ("operator/src", "."))
    kept = ("HOME", "XDG_CACHE_HOME", "PYTHONPYCACHEPREFIX")
    cache = {name: os.environ[name] for name in kept if name in os.environ}
    return {**cache, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}


def keep_report(folders: ClusterFolders, name: str, report: Any) -> None:
    """Leave what a process last saw, a dataclass of plain values, for who asks how the cluster is."""
    write_atomically(_report_file(folders, name), json.dumps(asdict(report)))


def read_report(folders: ClusterFolders, name: str, kind: type[R]) -> R | None:
    """What a process left last; None when there is nothing, or nothing that can be read."""
    try:
        return kind(**json.loads(_report_file(folders, name).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _report_file(folders: ClusterFolders, name: str) -> Path:
    return folders.base / f"{name}.json"
