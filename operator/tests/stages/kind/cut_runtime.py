"""A container runtime that asks for no more than this machine gives: it cuts down what a container or a process in it
shall be, and becomes runc.

    python cut_runtime.py RUNC [arguments of runc]

Where a capability is withheld (CAP_SYS_RESOURCE, on some virtual machines), runc cannot give it to containers that
Docker calls privileged, nor raise a hard limit, nor let a process be worth more than this one when memory is short.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# by their numbers, as linux/capability.h has them
CAPABILITIES = (
    "CHOWN DAC_OVERRIDE DAC_READ_SEARCH FOWNER FSETID KILL SETGID SETUID SETPCAP LINUX_IMMUTABLE NET_BIND_SERVICE "
    "NET_BROADCAST NET_ADMIN NET_RAW IPC_LOCK IPC_OWNER SYS_MODULE SYS_RAWIO SYS_CHROOT SYS_PTRACE SYS_PACCT SYS_ADMIN "
    "SYS_BOOT SYS_NICE SYS_RESOURCE SYS_TIME SYS_TTY_CONFIG MKNOD LEASE AUDIT_WRITE AUDIT_CONTROL SETFCAP MAC_OVERRIDE "
    "MAC_ADMIN SYSLOG WAKE_ALARM BLOCK_SUSPEND AUDIT_READ PERFMON BPF CHECKPOINT_RESTORE"
)
RAISING = "CAP_SYS_RESOURCE"


def held(status: str) -> frozenset[str]:
    """The capabilities that can be had, from what /proc/self/status says."""
    [mask] = (int(line.split()[1], 16) for line in status.splitlines() if line.startswith("CapBnd:"))
    return frozenset(f"CAP_{name}" for number, name in enumerate(CAPABILITIES.split()) if mask >> number & 1)


def cut(process: dict[str, Any], capabilities: frozenset[str], score: int) -> None:
    """Take from what a process shall be all that cannot be; `score` is this process's own for want of memory."""
    sets = process.get("capabilities") or {}
    for name, wanted in sets.items():
        sets[name] = [one for one in wanted or () if one in capabilities]
    if RAISING in capabilities:
        return
    for limit in process.get("rlimits") or ():
        _, hard = resource.getrlimit(getattr(resource, limit["type"]))
        if hard != resource.RLIM_INFINITY:
            limit["hard"] = min(limit["hard"], hard)
            limit["soft"] = min(limit["soft"], limit["hard"])
    if process.get("oomScoreAdj", score) < score:
        del process["oomScoreAdj"]


def value(arguments: Sequence[str], *names: str) -> str:
    """What follows an option, or stands behind its sign of equality; empty when it is not there."""
    for number, argument in enumerate(arguments):
        name, sign, text = argument.partition("=")
        if name in names:
            return text if sign else arguments[number + 1]
    return ""


def change(file: Path, capabilities: frozenset[str], score: int) -> None:
    """Cut down a container's configuration, or a process for one that runs: a file with that alone."""
    document = json.loads(file.read_text(encoding="utf-8"))
    cut(document.get("process", document), capabilities, score)
    part = file.with_name(f"{file.name}.part")
    part.write_text(json.dumps(document), encoding="utf-8")
    part.replace(file)


def main() -> None:
    runc, arguments = sys.argv[1], sys.argv[2:]
    capabilities = held(Path("/proc/self/status").read_text(encoding="ascii"))
    score = int(Path("/proc/self/oom_score_adj").read_text(encoding="ascii"))
    if {"create", "run"} & set(arguments):
        change(Path(value(arguments, "--bundle", "-b") or ".", "config.json"), capabilities, score)
    elif "exec" in arguments and (file := value(arguments, "--process", "-p")):
        change(Path(file), capabilities, score)
    os.execv(runc, [runc, *arguments])  # noqa: S606 - what Docker called becomes runc


if __name__ == "__main__":
    main()
