"""What other commands stand on: Debian packages, tool chain, images. Each step is cached, and done once per process."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from pathlib import Path

from ci import packages, preflight, toolchain
from ci.cluster.images import Image, lock_file, read_lock
from ci.images.building import NAMES, build_images
from ci.steps import Steps

TOOLCHAIN_VARIABLE = "ROBOTKUBE_TOOLCHAIN_BIN"


@dataclass(frozen=True)
class Prepared:
    """Programs of the tool chain, and the images by name (as the lock file lists them)."""

    binaries: Path
    images: tuple[Image, ...]

    def references(self) -> dict[str, str]:
        """Image name -> repository@digest."""
        return {image.name: image.reference for image in self.images}


@functools.cache
def tool_chain() -> Path:
    """Folder of the programs, built when they are not in the cache."""
    preflight.require()
    packages.ensure("toolchain", "cluster", "images")
    return toolchain.ensure().binaries


@functools.cache
def everything() -> Prepared:
    """Tool chain and images."""
    binaries = tool_chain()
    build_images(binaries, steps=Steps(len(NAMES)))
    return Prepared(binaries, tuple(read_lock(lock_file())))


@functools.cache
def for_tests() -> None:
    """Debian packages that tests and benchmarks run; a broker is put on this process's PATH."""
    packages.ensure("tests", "images")
    os.environ["PATH"] = os.pathsep.join([os.environ["PATH"], *map(str, packages.unpacked("mosquitto"))])


def prepare(needs: str) -> None:
    """Make what a group of tests `needs`: `nothing`, `tests`, `toolchain` (and tests), `images` (and all the others).

    The folder of the tool chain's programs is in the environment variable ROBOTKUBE_TOOLCHAIN_BIN from then on.
    """
    if needs != "nothing":
        for_tests()
    if needs in ("toolchain", "images"):
        os.environ[TOOLCHAIN_VARIABLE] = str(tool_chain())
    if needs == "images":
        everything()
