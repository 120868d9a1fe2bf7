"""What builds container images, as `robotkube image build` uses it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol


class Engine(Protocol):
    """A program that builds images from Dockerfiles. InputError: it refused, with the end of what it said."""

    @property
    def program(self) -> str:
        """Its name."""
        ...

    def has(self, tag: str) -> bool:
        """Return whether it has an image of that tag."""
        ...

    def load(self, archive: Path, tag: str) -> None:
        """Take the image of an OCI layout archive, which has the name `tag`."""
        ...

    def build(self, context: Path, dockerfile: Path, tag: str, arguments: Mapping[str, str]) -> None:
        """Build and tag."""
        ...

    def export(self, tag: str, folder: Path) -> None:
        """Write the image as a folder: manifest.json, configuration and plain layers named by hex digest."""
        ...
