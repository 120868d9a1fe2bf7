"""What the machine must have before anything is started; every miss is one sentence."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

from ci import packages
from ci.errors import SetUpError
from ci.folders import user_cache

MEMORY_MINIMUM_GIB = 12
DISK_MINIMUM_GIB = 20
GIB = 2**30
# A Unix socket's path holds 107 bytes; the longest below the cluster's folder is that of a node's kubelet.
CACHE_PATH_LENGTH_MAX = 60


def problems() -> tuple[str, ...]:
    """All sentences about what is missing or too small; empty when the machine will do. Starts nothing that stays."""
    if os.geteuid() != 0:
        return ("You are not root: the embedded cluster makes network namespaces and cgroups (use sudo).",)
    machine: tuple[Callable[[], str | None], ...] = (_packages, _namespaces, _control_groups, _bridges, _memory, _disk)
    checks = (*machine, _path, _go)
    return tuple(problem for problem in (check() for check in checks) if problem)


def require() -> None:
    """Raise SetUpError with every problem of this machine, one sentence per line."""
    sentences = problems()
    if sentences:
        raise SetUpError("\n".join(sentences))


def _namespaces() -> str | None:
    trial = subprocess.run(
        ["unshare", "--net", "--mount", "--propagation", "slave", "true"],
        capture_output=True,
        text=True,
        timeout=10,
        check=False,
    )
    if trial.returncode == 0:
        return None
    return f"Network and mount namespaces cannot be made here ({trial.stderr.strip()}): use a virtual machine."


def _control_groups() -> str | None:
    from ci.machine import cgroups

    try:
        cgroups.prove_writable()
    except OSError as error:
        return f"Control groups cannot be written ({error}): use a virtual machine, not a container."
    return None


def _bridges() -> str | None:
    from ci.machine import network_policies

    return network_policies.lacking()


def _memory() -> str | None:
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    available = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemTotal:"))
    if available >= (MEMORY_MINIMUM_GIB - 0.5) * GIB:
        return None
    return f"The machine has {available / GIB:.1f} GiB of memory; at least {MEMORY_MINIMUM_GIB} GiB are needed."


def _disk() -> str | None:
    folder = user_cache()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free >= DISK_MINIMUM_GIB * GIB or (user_cache() / "toolchain").exists():
        return None
    return (
        f"{folder} has {free / GIB:.1f} GiB free; the first run needs {DISK_MINIMUM_GIB} GiB "
        "(choose another place with XDG_CACHE_HOME)."
    )


def _path() -> str | None:
    if len(str(user_cache())) <= CACHE_PATH_LENGTH_MAX:
        return None
    return (
        f"The cache folder's path {user_cache()} is longer than {CACHE_PATH_LENGTH_MAX} characters: "
        "sockets below it would have too long names (choose another place with XDG_CACHE_HOME)."
    )


def _go() -> str | None:
    from ci.toolchain import go

    if go.find() is not None or shutil.which("apt-get") is not None:
        return None
    return f"Go is missing and there is no apt-get to install it: install {go.WANTED_NAME} or newer."


def _packages() -> str | None:
    try:
        absent = packages.missing(("cluster",))
    except SetUpError as error:
        return str(error)
    if absent and shutil.which("apt-get") is None:
        return "Debian packages are missing and there is no apt-get to install them: " + " ".join(absent)
    return None
