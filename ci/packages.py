"""Debian packages each part needs, and their installation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from ci.errors import SetUpError
from ci.folders import user_cache

INSTALL_TIMEOUT_SECONDS = 900
AS_ROOT = ("-o", "APT::Sandbox::User=root")  # the account apt uses otherwise may not write to the folders it is given

NEEDS: dict[str, tuple[str, ...]] = {
    "toolchain": ("ca-certificates", "gcc", "libc6-dev", "libseccomp-dev", "pkg-config"),
    "go": ("golang-go",),
    "arm64": ("gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross", "pkg-config"),  # compile for it on another machine
    "cluster": (
        "containernetworking-plugins",
        "iproute2",
        "nftables",
        "openssl",
        "procps",
        "util-linux",
    ),
    "images": ("buildah", "mmdebstrap"),
    "browser": ("chromium",),
    "engine": ("iptables", "libdevmapper1.02.1", "libsystemd0"),  # what a Docker engine of the tests calls and links
    # the last four are what the broker is linked with, see `unpacked`
    "tests": (
        "git",
        "iproute2",
        "openssh-client",
        "openssl",
        "util-linux",
        "libcjson1",
        "libdlt2",
        "libmosquitto1",
        "libwrap0",
    ),
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


def unpacked(package: str) -> tuple[Path, ...]:
    """Folders of the programs of a Debian package that is fetched but not installed: installing a server would start
    it, and tests run their own. What it is linked with must be in NEEDS. Kept below the user's cache folder.
    """
    folder = user_cache() / "debian" / package
    programs = (folder / "usr" / "sbin", folder / "usr" / "bin")
    if not any(path.is_dir() for path in programs):
        _unpack(folder, (package,))
    return programs


def unpacked_for(architecture: str, *packages: str) -> Path:
    """The folder of all files of Debian packages of another architecture, as below `/`. The system is not told of that
    architecture, and gets nothing: apt keeps its lists for it in a folder that goes. It is below the user's cache
    folder, and stays."""
    folder = user_cache() / "debian" / "-".join((*packages, architecture))
    if not folder.is_dir():
        _unpack(folder, packages, architecture)
    return folder


def _unpack(folder: Path, packages: tuple[str, ...], architecture: str = "") -> None:
    """Fetch packages and unpack them into `folder`, which appears when all are there."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as made:
        own = _own_state(Path(made), architecture) if architecture else []
        what = f" for {architecture}" if architecture else ""
        _apt_get([*own, "update"], f"apt-get update{what}")
        _apt_get([*own, *AS_ROOT, "download", *packages], f"apt-get download {' '.join(packages)}{what}", made)
        for archive in sorted(Path(made).glob("*.deb")):
            subprocess.run(["dpkg-deb", "--extract", archive, Path(made) / "files"], check=True, timeout=60)
        (Path(made) / "files").rename(folder)


def _own_state(folder: Path, architecture: str) -> list[str]:
    """Options by which apt knows another architecture alone, no installed package, and keeps what it reads below
    `folder`; its sources are the system's."""
    state, cache = folder / "state", folder / "cache"
    for place in (state / "lists" / "partial", cache / "archives" / "partial"):
        place.mkdir(parents=True)
    (state / "status").touch()
    settings = {
        "APT::Architecture": architecture,
        "APT::Architectures": architecture,
        "Dir::State": state,
        "Dir::State::status": state / "status",
        "Dir::Cache": cache,
    }
    return [*AS_ROOT, *(word for name, value in settings.items() for word in ("-o", f"{name}={value}"))]


def _apt_get(arguments: list[str], command: str, folder: str | None = None) -> None:
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    result = subprocess.run(
        ["apt-get", "-qq", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=INSTALL_TIMEOUT_SECONDS,
        check=False,
    )
    if result.returncode != 0:
        raise SetUpError(f"{command} failed: {result.stderr.strip()[-500:]}")
