"""Which program builds images here."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from robotkube.errors import InputError
from robotkube.registry.images.adapters.buildah import Buildah
from robotkube.registry.images.adapters.docker import Docker
from robotkube.registry.images.ports import Engine

PROGRAMS = ("buildah", "podman", "docker")  # the first that is there is taken
DRIVER_VARIABLE = "STORAGE_DRIVER"  # the one that buildah and podman read
LACKING = "no program that builds images is here: install buildah (apt-get install buildah), podman or docker"


def choose_engine(
    folder: Path,
    wanted: str = "",
    which: Callable[[str], str | None] = shutil.which,
    environment: Mapping[str, str] | None = None,
) -> Engine:
    """The program `wanted`, or the first of PROGRAMS that is there; `folder` is its own, kept between builds."""
    present = [name for name in ((wanted,) if wanted else PROGRAMS) if which(name)]
    if not present:
        raise InputError(f"{wanted} is not on the PATH; {LACKING}" if wanted else LACKING)
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "build.log"
    log.unlink(missing_ok=True)
    if present[0] == "docker":
        return Docker(log)
    given = os.environ if environment is None else environment
    driver = given.get(DRIVER_VARIABLE) or ("overlay" if os.geteuid() == 0 else "vfs")
    return Buildah(folder / f"storage-{driver}", log, present[0], driver, fetching=True)
