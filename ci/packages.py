"""Debian packages each part needs, and their installation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable

from ci.errors import SetUpError

INSTALL_TIMEOUT_SECONDS = 900

NEEDS: dict[str, tuple[str, ...]] = {
    "toolchain": ("ca-certificates", "gcc", "libc6-dev", "libseccomp-dev", "pkg-config"),
    "go": ("golang-go",),
    "cluster": (
        "containernetworking-plugins",
        "iproute2",
        "nftables",
        "openssl",
        "procps",
        "util-linux",
    ),
    "images": ("buildah", "mmdebstrap"),
}


def missing(groups: Iterable[str]) -> tuple[str, ...]:
    """Names of the packages of `groups` (keys of NEEDS) that are not installed, sorted."""
    wanted = sorted({package for group in groups for package in NEEDS[group]})
    if shutil.which("dpkg-query") is None:
        raise SetUpError("this is no Debian system (dpkg-query is missing): install by hand: " + " ".join(wanted))
    query = ["dpkg-query", "--show", "--showformat=${Package} ${db:Status-Status}\n", *wanted]
    answer = subprocess.run(query, capture_output=True, text=True, check=False, timeout=60)
    installed = {line.split()[0] for line in answer.stdout.splitlines() if line.endswith(" installed")}
    return tuple(package for package in wanted if package not in installed)


def ensure(*groups: str) -> None:
    """Install what is missing of `groups` with apt-get; raises SetUpError naming packages and the command to run."""
    absent = missing(groups)
    if not absent:
        return
    command = "apt-get install --no-install-recommends " + " ".join(absent)
    if os.geteuid() != 0:
        raise SetUpError(f"Debian packages are missing; run as root: {command}")
    print("installing Debian packages: " + " ".join(absent), file=sys.stderr, flush=True)
    for arguments in (["update"], ["install", "-y", "--no-install-recommends", *absent]):
        _apt_get(arguments, command)


def _apt_get(arguments: list[str], command: str) -> None:
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    result = subprocess.run(
        ["apt-get", "-qq", *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=INSTALL_TIMEOUT_SECONDS,
        check=False,
    )
    if result.returncode != 0:
        raise SetUpError(f"{command} failed: {result.stderr.strip()[-500:]}")
