"""Tool chain and images, which other commands stand on. Each step is cached, and done once per process."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from ci.images.building import NAMES, build_images
from ci.images.image_lock import Image, lock_file, read_lock
from ci.machine.preparing import tool_chain
from ci.steps import Steps


@dataclass(frozen=True)
class Prepared:
    """Programs of the tool chain, and the images by name (as the lock file lists them)."""

    binaries: Path
    images: tuple[Image, ...]

    def references(self) -> dict[str, str]:
        """Image name -> repository@digest."""
        return {image.name: image.reference for image in self.images}


@functools.cache
def everything() -> Prepared:
    """Tool chain and images."""
    binaries = tool_chain()
    build_images(binaries, steps=Steps(len(NAMES)))
    return Prepared(binaries, tuple(read_lock(lock_file())))
