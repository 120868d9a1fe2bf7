"""The cluster's processes: started in a control group, recorded with pid and start time, found again, killed.

A process is the recorded one only if its start time equals: pids are used again.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ci.cluster.embedded.host import runc_records
from ci.cluster.embedded.host.records import ClusterFolders, write_atomically
from ci.errors import SetUpError
from ci.machine import cgroups

MARK = "ROBOTKUBE_CLUSTER"
# All are Go programs with small heaps: memory is there, time is what dozens of them on two cores lack.
COLLECTING = {"GOGC": "400"}
LOG_LINES = 15
KILL_TIMEOUT_SECONDS = 20
PAUSE_SECONDS = 0.05
SEARCH_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
JOIN = 'for folder in $1; do echo $$ > "$folder/cgroup.procs" || exit 1; done; shift; exec "$@"'
# Runs a program until it ends well.
AGAIN = 'until "$@"; do echo "$1 ended with $?: started again in 1 s" >&2; sleep 1; done'
# The daemon becomes a child of init, not of whoever starts the cluster; `setsid` does not fork here, so $! is its pid.
DETACH = 'log=$1; shift; setsid "$@" < /dev/null >> "$log" 2>&1 & echo $!'
START_TIMEOUT_SECONDS = 10


@dataclass(frozen=True)
class Process:
    """A recorded process; `start_ticks` is field 22 of /proc/<pid>/stat."""

    name: str
    pid: int
    start_ticks: int
    command: tuple[str, ...]
    log: str

    def alive(self) -> bool:
        """Return whether this very process runs (not ended, not a zombie, not another one with its pid)."""
        return start_ticks(self.pid) == self.start_ticks

    def last_lines(self, count: int = LOG_LINES) -> str:
        """The end of its log."""
        try:
            lines = Path(self.log).read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return "(no log)"
        return "\n".join("  | " + line[:300] for line in lines[-count:])


def start_ticks(pid: int) -> int | None:
    """The process's start, in clock ticks after boot; None if there is none or it is a zombie."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])


class Launcher:
    """Starts the processes of one cluster."""

    def __init__(self, folders: ClusterFolders, binaries: Path) -> None:
        self.folders = folders
        self.binaries = binaries

    def start(
        self,
        name: str,
        command: Sequence[str],
        prefix: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        weight: int | None = None,
    ) -> Process:
        """Start `command` (its first word below `binaries` if it has no slash) through `prefix` (nsenter ...).
        `weight`: see `cgroups`; None: that of an earlier start."""
        program = command[0] if "/" in command[0] else str(self.binaries / command[0])
        groups = " ".join(map(str, cgroups.daemon_folders(self.folders.name, name, weight)))
        log = self.folders.log / f"{name}.log"
        for folder in (self.folders.log, self.folders.processes):
            folder.mkdir(parents=True, exist_ok=True)
        words = [*prefix, program, *command[1:]]
        pid = self._detached(["/bin/sh", "-c", JOIN, "join", groups, *words], log, environment or {})
        process = Process(name, pid, start_ticks(pid) or 0, tuple(words), str(log))
        write_atomically(self.folders.processes / f"{name}.json", json.dumps(asdict(process)))
        return process

    def _detached(self, command: Sequence[str], log: Path, environment: Mapping[str, str]) -> int:
        answer = subprocess.run(
            ["/bin/sh", "-c", DETACH, "detach", str(log), *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            cwd="/",
            env=self._environment(environment),
            timeout=START_TIMEOUT_SECONDS,
            check=True,
        )
        return int(answer.stdout)

    def _environment(self, more: Mapping[str, str]) -> dict[str, str]:
        return {"PATH": f"{self.binaries}:{SEARCH_PATH}", "HOME": "/", MARK: self.folders.name, **COLLECTING, **more}


def recorded(folders: ClusterFolders, names: str = "*") -> tuple[Process, ...]:
    """All recorded processes of such names, ended ones too, by name."""
    processes = []
    for path in sorted(folders.processes.glob(f"{names}.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        processes.append(Process(**{**document, "command": tuple(document["command"])}))
    return tuple(processes)


def wait_until(condition: Callable[[], bool], what: str, seconds: float, culprits: Sequence[Process]) -> None:
    """Wait for `condition`, at most `seconds`; raises SetUpError with the log of the process that ended, or of all."""
    deadline = time.monotonic() + seconds
    while not condition():
        dead = [process for process in culprits if not process.alive()]
        if dead:
            raise SetUpError(f"{dead[0].name} ended while waiting for {what}; {dead[0].log}:\n{dead[0].last_lines()}")
        if time.monotonic() > deadline:
            logs = "\n".join(f"{process.log}:\n{process.last_lines()}" for process in culprits[:3])
            raise SetUpError(f"{what} did not come within {seconds:.0f} s; last lines of the processes:\n{logs}")
        time.sleep(PAUSE_SECONDS)


def strays(cluster: str) -> set[int]:
    """Every process of the cluster that can be found: by record, control group and the mark in its environment, and
    what runs in containers that somebody started by a node's runtime."""
    folders = ClusterFolders(cluster)
    pids = {process.pid for process in recorded(folders) if process.alive()}
    pids |= cgroups.processes(cluster)
    pids |= in_containers(folders.nodes)
    mark = f"{MARK}={cluster}".encode()
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            if mark in (entry / "environ").read_bytes().split(b"\0"):
                pids.add(int(entry.name))
        except OSError:
            continue  # ended meanwhile
    return {pid for pid in pids if start_ticks(pid) is not None and pid != os.getpid()}


def in_containers(nodes: Path, node: str = "*") -> set[int]:
    """The first processes of containers that run on one node, or on all in a folder."""
    return {pid for pid, start in runc_records.first_processes(nodes, node) if start_ticks(pid) == start}


def kill_all(cluster: str) -> set[int]:
    """Kill every process of the cluster, again until none is found; returns those that outlived the bound."""
    deadline = time.monotonic() + KILL_TIMEOUT_SECONDS
    while (pids := strays(cluster)) and time.monotonic() < deadline:
        for pid in pids:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        time.sleep(PAUSE_SECONDS)
    return pids
