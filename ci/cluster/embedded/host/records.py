"""What a start did to the machine, written before it is done, so that `down` can undo a start that was killed half-way.

<cache>/clusters/<name>/record.json       specification, former sysctl values, folders made outside of the cache
<cache>/clusters/<name>/processes/*.json  one file per process: pid, start time, command, log
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ci.errors import SetUpError
from ci.folders import user_cache

LOCK_TIMEOUT_SECONDS = 30
LOCK_PAUSE_SECONDS = 0.2


@dataclass(frozen=True)
class ClusterFolders:
    """The places of one cluster's files."""

    name: str

    @property
    def base(self) -> Path:
        """Everything of this cluster; `down` empties it but for `log`."""
        return user_cache() / "clusters" / self.name

    @property
    def pki(self) -> Path:
        """Keys and certificates."""
        return self.base / "pki"

    @property
    def log(self) -> Path:
        """One log per process; kept until the next start."""
        return self.base / "log"

    @property
    def processes(self) -> Path:
        """One record per process."""
        return self.base / "processes"

    @property
    def record(self) -> Path:
        """The record of what the start did."""
        return self.base / "record.json"

    @property
    def volumes(self) -> Path:
        """Contents of the persistent volumes, by node."""
        return self.base / "volumes"

    @property
    def hosts(self) -> Path:
        """From where nodes pull images (nodes/pulling.py)."""
        return self.base / "certs.d"

    @property
    def kubeconfig(self) -> Path:
        """The administrator's kubeconfig."""
        return self.base / "kubeconfig"

    @property
    def nodes(self) -> Path:
        """A folder for each node."""
        return self.base / "nodes"

    def node(self, name: str) -> Path:
        """One node's files."""
        return self.nodes / name


@dataclass
class Record:
    """A cluster's record. `specification` says what was asked for; `complete` is set when the start had succeeded."""

    specification: str = ""
    complete: bool = False
    sysctls: dict[str, str] = field(default_factory=dict)
    made_folders: list[str] = field(default_factory=list)
    images: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Record:
        """The record at `path`; an empty one when there is none or a kill left half a file."""
        try:
            document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return cls()
        return cls(**document)

    def write(self, path: Path) -> None:
        """Replace the file at once, so that a kill leaves the old or the new one."""
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps(asdict(self), indent=1))


def write_atomically(path: Path, text: str) -> None:
    """Write beside `path`, then rename."""
    partial = path.with_name(path.name + f".{os.getpid()}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Let one process at a time start or stop clusters; the kernel frees the lock of a killed one.

    Raises SetUpError when another one holds it longer than the bound.
    """
    path = user_cache() / "clusters" / "lock"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as lock:
        deadline = time.monotonic() + LOCK_TIMEOUT_SECONDS
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise SetUpError(
                        f"another process has been starting or stopping a cluster for {LOCK_TIMEOUT_SECONDS} s "
                        f"(lock {path}): wait for it or end it"
                    ) from None
                time.sleep(LOCK_PAUSE_SECONDS)
        yield
