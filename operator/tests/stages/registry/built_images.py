"""Images as they are built here: an archive and its bill of materials in one folder each."""

from __future__ import annotations

from pathlib import Path

from ci.images.built import ARCHIVE, REPOSITORY
from ci.images.image_lock import Image
from robotkube.registry.images.adapters import bills
from tests.stages.registry.made_archives import write_archive


def built_image(folder: Path, name: str, layer: bytes = b"layer") -> Image:
    """A small one, below a folder."""
    place = folder / name
    place.mkdir(parents=True, exist_ok=True)
    digest = write_archive(place / ARCHIVE, [layer])
    (place / bills.FILE).write_bytes(b'{"bomFormat":"CycloneDX"}')
    return Image(name, f"{REPOSITORY}/{name}@{digest}", place / ARCHIVE)
