"""The Debian that a node runs, as kind's own base image has it: systemd, and what kubelet, kube-proxy and kind call.

bookworm, although kind's is newer: its systemd takes both versions of control groups. Network storage and the file
systems of engines without root are left out.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from ci.images import machine
from robotkube.registry.images.adapters.buildah import run_logged

RELEASE = "bookworm"
PACKAGES = (
    "bash",
    "ca-certificates",
    "conntrack",
    "containernetworking-plugins",
    "curl",
    "e2fsprogs",
    "ethtool",
    "iproute2",
    "iptables",
    "jq",
    "kmod",
    "libseccomp2",
    "mount",
    "nftables",
    "pigz",
    "procps",
    "systemd",
    "usr-is-merged",  # else the package usrmerge and with it all of Perl
    "util-linux",
)
LEFT_OUT = (
    "/usr/share/doc/*",
    "/usr/share/man/*",
    "/usr/share/locale/*",
    "/usr/share/info/*",
)
OPTIONS = (
    "--quiet",
    "--mode=root",
    "--variant=minbase",
    f"--include={','.join(PACKAGES)}",
    "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr",
    '--aptopt=APT::Install-Recommends "false"',
    '--aptopt=Acquire::Languages "none"',
    *(f"--dpkgopt=path-exclude={path}" for path in LEFT_OUT),
)
MADE_SECONDS_MAX = 1800


def key() -> str:
    """What it depends on, besides Debian's own state at the time."""
    return hashlib.sha256("\n".join([RELEASE, *OPTIONS]).encode()).hexdigest()[:16]


def ensure(folder: Path, log: Path) -> Path:
    """The archive of the root folder, made in `folder` if it is not there. BuildError has the end of what was said."""
    archive = folder / f"debian-{key()}.tar"
    if archive.is_file():
        return archive
    part = archive.with_name(f"part-{archive.name}")
    part.unlink(missing_ok=True)
    sources = machine.debian_sources()
    words = [RELEASE, str(part), *([str(sources)] if sources else [])]
    run_logged(["mmdebstrap", *OPTIONS, *words], log, MADE_SECONDS_MAX, {})
    for older in folder.glob("debian-*.tar"):
        older.unlink()
    return part.rename(archive)
