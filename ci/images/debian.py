"""The Debian that the base image stands on, made from Debian's packages where no image registry can be reached."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

from robotkube.registry.images.adapters.buildah import Buildah, BuildError, run_logged
from robotkube.registry.images.adapters.normalising import EPOCH_SECONDS

TAG = "docker.io/library/debian:bookworm-slim"
ROOT_SECONDS_MAX = 600
FREE_BYTES_MIN = 6_000_000_000
LEFT_OUT = ("/usr/share/doc/*", "/usr/share/man/*", "/usr/share/locale/*", "/usr/share/info/*", "/usr/share/lintian/*")
OPTIONS = (
    "--variant=apt",
    "--include=usr-is-merged",  # else the package usrmerge and with it all of Perl
    "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr",
    '--aptopt=APT::Install-Recommends "false"',
    '--aptopt=Acquire::Languages "none"',
    *(f"--dpkgopt=path-exclude={path}" for path in LEFT_OUT),
)
UNWANTED_FILES = (
    "/etc/apt/sources.list",
    "/etc/apt/sources.list.d/0000debian.sources",
    "/etc/hostname",
    "/etc/resolv.conf",
)


def key() -> str:
    """What the Debian root depends on, besides Debian's own state at the time."""
    return hashlib.sha256("\n".join([TAG, *OPTIONS, *UNWANTED_FILES]).encode()).hexdigest()[:16]


def make(buildah: Buildah, sources: Path | None) -> None:
    """Make the Debian image in buildah's storage; `sources` are the APT sources to use, or Debian's own servers.

    With the machine's own sources none stay in the image: they are lent to every later build. Needs root.
    """
    with tempfile.TemporaryDirectory(dir=buildah.storage.parent, prefix=".debian-") as folder:
        root = Path(folder) / "root.tar"
        hooks = [f'--customize-hook=rm -f "$1"{path}' for path in UNWANTED_FILES] if sources else []
        command = [
            "mmdebstrap",
            "--quiet",
            *OPTIONS,
            *hooks,
            "bookworm",
            str(root),
            *([str(sources)] if sources else []),
        ]
        run_logged(command, buildah.log, ROOT_SECONDS_MAX, {"SOURCE_DATE_EPOCH": str(EPOCH_SECONDS)})
        (Path(folder) / "Dockerfile").write_text("FROM scratch\nADD root.tar /\n", encoding="utf-8")
        buildah.build(Path(folder), Path(folder) / "Dockerfile", TAG, {}, (), fresh=False)


def require_programs(folder: Path) -> None:
    """Say what the machine lacks for building in `folder` before anything is started."""
    missing = [name for name in ("buildah", "mmdebstrap") if shutil.which(name) is None]
    if missing:
        packages = " ".join(missing)
        raise BuildError(f"missing: {packages}; apt-get install -y --no-install-recommends {packages}")
    if os.geteuid() != 0:
        raise BuildError("building images needs root (overlay mounts and chroot); run as root")
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES_MIN:
        raise BuildError(f"{folder}: {free / 1e9:.1f} GB free, building images needs {FREE_BYTES_MIN / 1e9:.0f} GB")
