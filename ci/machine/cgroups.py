"""Control groups of a cluster, version 1 (each controller a hierarchy) and version 2 (one hierarchy).

    /robotkube-<cluster>/daemons/<process>   the processes of the cluster itself
    /robotkube-<cluster>/<node>/...          kubelet's cgroupRoot, with the pods below

On version 1 the daemons are put into the hierarchies of processor time only; the others stay as the caller has them.

All machines of the cluster share the processors of one. Left to themselves a thread of any daemon weighs as much as all
pods together, and each kubelet reads the open files of all that stand in the root folder. So everything has a folder
and a weight here (100 is an ordinary one): what is to keep its pace goes first.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path("/sys/fs/cgroup")
ACCOUNTING = "cpuacct"
TIME_V1 = (ACCOUNTING, "cpu")
SHARES_OF_100 = 1024  # version 1 writes a weight of 100 like that
TOP_WEIGHT, DAEMONS_WEIGHT = 800, 100
CPUSET_FILES = ("cpuset.cpus", "cpuset.mems")
REMOVAL_ATTEMPTS = 50
REMOVAL_PAUSE_SECONDS = 0.1
CONTROLLERS_V2 = ("cpuset", "cpu", "io", "memory", "pids")


def unified() -> bool:
    """Return whether control groups are of version 2; False on version 1 and hybrid."""
    return (ROOT / "cgroup.controllers").exists()


def hierarchies() -> tuple[Path, ...]:
    """Mount points of all hierarchies; one on version 2. Links (cpu -> cpu,cpuacct) are not listed twice."""
    if unified():
        return (ROOT,)
    return tuple(sorted({entry.resolve() for entry in ROOT.iterdir() if (entry / "cgroup.procs").exists()}))


def top(cluster: str) -> str:
    """The cluster's folder in every hierarchy."""
    return f"robotkube-{cluster}"


def daemon_folders(cluster: str, process: str, weight: int | None = None) -> tuple[Path, ...]:
    """The folders a daemon joins, made if they are not there. `weight` among the daemons; None: as it is."""
    bases = (ROOT,) if unified() else tuple(sorted({(ROOT / name).resolve() for name in TIME_V1}))
    folders = []
    for base in bases:
        folder = base / top(cluster) / "daemons" / process
        folder.mkdir(parents=True, exist_ok=True)
        _weigh(base / top(cluster), TOP_WEIGHT)
        _weigh(folder.parent, DAEMONS_WEIGHT)
        if weight is not None:
            _weigh(folder, weight)
        folders.append(folder)
    return tuple(folders)


def node_root(cluster: str, node: str, weight: int) -> str:
    """Make a node's folder in every hierarchy; returns it as kubelet's cgroupRoot. cpusets begin empty on version 1."""
    for hierarchy in hierarchies():
        folder = hierarchy
        for part in (top(cluster), node):
            if unified():
                _delegate(folder)
            folder = folder / part
            folder.mkdir(exist_ok=True)
            _inherit_cpuset(hierarchy, folder)
        _weigh(folder, weight)
    return f"/{top(cluster)}/{node}"


def _weigh(folder: Path, weight: int) -> None:
    """Write the weight of a folder, where it has a say in processor time."""
    for name, value in (("cpu.weight", weight), ("cpu.shares", weight * SHARES_OF_100 // 100)):
        if (folder / name).exists():
            (folder / name).write_text(str(value))


def _inherit_cpuset(hierarchy: Path, folder: Path) -> None:
    if unified():
        return
    for name in CPUSET_FILES:
        if (folder / name).exists():
            (folder / name).write_text((hierarchy / name).read_text())


def _delegate(folder: Path) -> None:
    available = (folder / "cgroup.controllers").read_text().split()
    wanted = " ".join(f"+{name}" for name in CONTROLLERS_V2 if name in available)
    (folder / "cgroup.subtree_control").write_text(wanted)


def folders(cluster: str) -> tuple[Path, ...]:
    """Every folder of the cluster in every hierarchy, the deepest first."""
    paths = [
        Path(parent) for hierarchy in hierarchies() for parent, _, _ in os.walk(hierarchy / top(cluster), topdown=False)
    ]
    return tuple(paths)


def processes(cluster: str) -> set[int]:
    """Process ids in any folder of the cluster."""
    return {pid for folder in folders(cluster) for pid in _members(folder)}


def processes_of_node(cluster: str, node: str, daemons: tuple[str, ...]) -> set[int]:
    """Process ids of a node's pods and of the named daemons with their children."""
    places = {(top(cluster), node), *((top(cluster), "daemons", daemon) for daemon in daemons)}
    pids: set[int] = set()
    for hierarchy in hierarchies():
        for place in places:
            for parent, _, _ in os.walk(hierarchy.joinpath(*place)):
                pids |= set(_members(Path(parent)))
    return pids


def _members(folder: Path) -> Iterator[int]:
    try:
        yield from map(int, (folder / "cgroup.procs").read_text().split())
    except OSError:
        return  # the folder went away meanwhile, or is a threaded one


def remove(cluster: str) -> tuple[Path, ...]:
    """Remove the cluster's folders; returns those that stayed after the bounded attempts."""
    for _ in range(REMOVAL_ATTEMPTS):
        for folder in folders(cluster):
            _remove_empty(folder)  # one that still has members is found by the next attempt
        if not folders(cluster):
            return ()
        time.sleep(REMOVAL_PAUSE_SECONDS)
    return folders(cluster)


def remove_foreign(paths: Iterable[Path]) -> tuple[Path, ...]:
    """Remove folders outside of the cluster's, with what is below them; returns those that stayed. The folder above
    goes as well when nothing else is in it: a runtime makes one for each of its namespaces."""
    left = tuple(paths)
    above = {path.parent for path in left}
    for _ in range(REMOVAL_ATTEMPTS):
        for path in left:
            for parent, _, _ in os.walk(path, topdown=False):
                _remove_empty(Path(parent))
        left = tuple(path for path in left if path.is_dir())
        if not left:
            break
        time.sleep(REMOVAL_PAUSE_SECONDS)
    for path in above - set(hierarchies()):
        _remove_empty(path)
    return left


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):  # it has members, or went away
        folder.rmdir()


def cpu_seconds(cluster: str, process: str) -> float | None:
    """Seconds of processor time of a daemon and all its children, the ended ones included; None if it has no folder."""
    base = ROOT if unified() else (ROOT / ACCOUNTING).resolve()
    folder = base / top(cluster) / "daemons" / process
    try:
        if not unified():
            return int((folder / "cpuacct.usage").read_text()) / 1e9
        fields = dict(line.split() for line in (folder / "cpu.stat").read_text().splitlines())
        return int(fields["usage_usec"]) / 1e6
    except OSError:
        return None


def prove_writable() -> None:
    """Make and remove a folder in every hierarchy; raises OSError."""
    for hierarchy in hierarchies():
        trial = hierarchy / f"robotkube-trial-{os.getpid()}"
        trial.mkdir()
        trial.rmdir()
