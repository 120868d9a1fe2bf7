"""Mounts of a cluster: on this machine below the cluster's folder, and in the mount namespaces of its nodes.

Read from /proc/<pid>/mountinfo (proc_pid_mountinfo(5)).
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
ESCAPED = re.compile(r"\\([0-7]{3})")  # space, tab, newline and backslash, in octal


@dataclass(frozen=True)
class Mount:
    """One line of mountinfo: which file system, which folder of it, and where it is mounted."""

    device: str
    root: str
    place: str


def read(process: int | str, proc: Path = PROC) -> tuple[Mount, ...]:
    """The mounts that a process sees (`self`: this one), in the order in which they were made."""
    lines = (proc / str(process) / "mountinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    return tuple(Mount(*map(_plain, line.split()[2:5])) for line in lines)


def below(folder: Path, proc: Path = PROC) -> tuple[str, ...]:
    """Mount points below a folder of this machine, in the order in which they were mounted."""
    return tuple(mount.place for mount in read("self", proc) if mount.place.startswith(f"{folder}/"))


def in_namespaces(processes: Iterable[int], proc: Path = PROC) -> int:
    """How many mounts the mount namespaces of these processes have that this machine's own has not; a namespace that
    several of them share counts once."""
    namespaces: dict[str, int] = {}
    for process in processes:
        with contextlib.suppress(OSError):  # ended meanwhile
            namespaces[str((proc / str(process) / "ns" / "mnt").readlink())] = process
    here = set(read("self", proc))
    count = 0
    for process in namespaces.values():
        with contextlib.suppress(OSError):
            count += len(set(read(process, proc)) - here)
    return count


def _plain(text: str) -> str:
    return ESCAPED.sub(lambda escaped: chr(int(escaped[1], 8)), text)
