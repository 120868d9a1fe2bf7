"""Removing a cluster completely, also one whose start was killed half-way, and proving it."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path

from ci.cluster.embedded.host import mounts, processes, runc_records
from ci.cluster.embedded.host.records import ClusterFolders, Record
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.addresses import plan_of
from ci.errors import SetUpError
from ci.machine import cgroups


def remove(name: str, keep_logs: bool = True) -> tuple[str, ...]:
    """Undo everything a start of this cluster did, in an order in which nothing comes back; what it removed, a line for
    each kind, none when there was nothing.

    Mounts and network namespaces of the nodes end with their last process. Raises SetUpError listing what is left.
    """
    folders = ClusterFolders(name)
    plan = plan_of(name)
    removed = tuple(_existing(name))
    record = Record.read(folders.record)
    processes.kill_all(name)
    host_network.remove(plan)
    cgroups.remove(name)
    cgroups.remove_foreign(runc_records.foreign_groups(folders.nodes, name))
    _unmount(folders.base)
    host_network.restore_sysctls(record)
    for folder in reversed(record.made_folders):
        if Path(folder).is_dir() and not any(Path(folder).iterdir()):
            Path(folder).rmdir()
    left = leftovers(name)
    if left:
        raise SetUpError(f"cluster {name} could not be removed completely; left are: {'; '.join(left)}")
    _remove_files(folders, keep_logs)
    return removed


def _existing(name: str) -> Iterator[str]:
    """What exists of the cluster, in words for people; files that a removal keeps are not among it."""
    folders = ClusterFolders(name)
    plan = plan_of(name)
    strays = processes.strays(name)
    yield from _counted("process", "processes", len(strays))
    yield from _counted("network namespace", "network namespaces", len(_networks(strays)))
    for kind, names in (("links", host_network.links(plan)), ("nftables", host_network.tables(plan))):
        yield from [f"{kind}: {', '.join(names)}"] if names else []
    yield from _counted("route", "routes", len(host_network.routes(plan)))
    groups = (*cgroups.folders(name), *runc_records.foreign_groups(folders.nodes, name))
    yield from _counted("control group", "control groups", len(groups))
    own = [process.pid for process in processes.recorded(folders) if process.alive()]
    yield from _counted("mount", "mounts", len(mounts.below(folders.base)) + mounts.in_namespaces(own))
    made = [folder for folder in Record.read(folders.record).made_folders if Path(folder).exists()]
    yield from [f"folders: {', '.join(made)}"] if made else []
    files = sorted(entry.name for entry in folders.base.iterdir()) if folders.base.is_dir() else []
    gone = [file for file in files if file != folders.log.name]
    yield from [f"files of {folders.base}: {', '.join(gone)}"] if gone else []


def _counted(one: str, many: str, count: int) -> Iterator[str]:
    yield from [f"{count} {one if count == 1 else many}"] if count else []


def _networks(pids: Iterable[int]) -> set[str]:
    """The network namespaces of these processes that are not this machine's own."""
    networks = set()
    for pid in pids:
        with contextlib.suppress(OSError):  # ended meanwhile
            networks.add(str(Path(f"/proc/{pid}/ns/net").readlink()))
    return networks - {str(Path("/proc/self/ns/net").readlink())}


def leftovers(name: str) -> tuple[str, ...]:
    """Everything of the cluster that is on the machine outside of the cache folder; empty when there is nothing."""
    folders = ClusterFolders(name)
    plan = plan_of(name)
    record = Record.read(folders.record)
    left = [f"process {pid}" for pid in sorted(processes.strays(name))]
    left += [f"link {link}" for link in host_network.links(plan)]
    left += [f"nftables {table}" for table in host_network.tables(plan)]
    left += [f"route {route}" for route in host_network.routes(plan)]
    groups = (*cgroups.folders(name), *runc_records.foreign_groups(folders.nodes, name))
    left += [f"cgroup {folder}" for folder in groups]
    left += [f"mount {place}" for place in mounts.below(folders.base)]
    left += [f"folder {folder}" for folder in record.made_folders if Path(folder).exists()]
    return tuple(left)


def _unmount(base: Path) -> None:
    for place in reversed(mounts.below(base)):
        subprocess.run(["umount", "--lazy", place], capture_output=True, timeout=30, check=False)


def _remove_files(folders: ClusterFolders, keep_logs: bool) -> None:
    if not folders.base.is_dir():
        return
    for entry in folders.base.iterdir():
        if entry == folders.log and keep_logs:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
