"""Network policies on this machine: whether they are to be enforced, and what the kernel lacks for that."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from ci.errors import InputError

VARIABLE = "ROBOTKUBE_NETWORK_POLICIES"
ON, OFF = "on", "off"
CHOICES = (ON, OFF)
SETTINGS = Path("/proc/sys")
BRIDGE_MODULE, BRIDGED = "br_netfilter", "net.bridge.bridge-nf-call-iptables"
TIMEOUT_SECONDS = 30


def choice() -> str:
    """Return whether policies are enforced: what the environment's ROBOTKUBE_NETWORK_POLICIES says, else on."""
    word = os.environ.get(VARIABLE, "") or ON
    if word not in CHOICES:
        raise InputError(f"{VARIABLE}: {word!r} must be one of {', '.join(CHOICES)}")
    return word


def lacking(settings: Path = SETTINGS) -> str | None:
    """What this machine lacks to enforce policies, in a sentence; None when they are not to be enforced."""
    if choice() == OFF or filters_bridges(settings):
        return None
    return (
        f"The kernel has no {BRIDGE_MODULE}, so network policies would not hold between pods of one node: "
        f"install the module, or set {VARIABLE}={OFF}."
    )


def filters_bridges(settings: Path = SETTINGS) -> bool:
    """Return whether rules can see what passes a bridge, perhaps once the kernel's module is loaded."""
    if sysctl(BRIDGED, settings).exists():
        return True
    trial = ["modprobe", "--dry-run", "--quiet", BRIDGE_MODULE]
    return bool(shutil.which(trial[0])) and not subprocess.run(trial, check=False, timeout=TIMEOUT_SECONDS).returncode


def sysctl(name: str, settings: Path = SETTINGS) -> Path:
    """The file of a setting of the kernel."""
    return settings / name.replace(".", "/")
