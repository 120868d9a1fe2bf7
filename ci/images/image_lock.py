"""The lock of images: which ones the builds made, and where their archives are."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ci.errors import InputError
from ci.folders import user_cache

SANDBOX = "pause"


@dataclass(frozen=True)
class Image:
    """One image of the lock file: `reference` is REPOSITORY@sha256:<manifest>, `archive` an OCI layout in a tar,
    `ground` that of the image it was cut from, which has the layers that are not in `archive`."""

    name: str
    reference: str
    archive: Path
    ground: Path | None = None

    @property
    def repository(self) -> str:
        """The reference without its digest."""
        return self.reference.partition("@")[0]


def lock_file() -> Path:
    """The file to which the image builds write their lock."""
    return user_cache() / "images" / "images.json"


def read_lock(path: Path) -> tuple[Image, ...]:
    """The images of a lock file, by name; raises InputError naming file and key."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); build the images first: make images") from error
    except ValueError as error:
        raise InputError(f"{path}: is not JSON: {error}") from error
    images = tuple(_image(path, name, entry) for name, entry in sorted(document.items()))
    if SANDBOX not in document:
        raise InputError(f"{path}: {SANDBOX}: is missing; every pod's sandbox runs it")
    return images


def _image(file: Path, name: str, entry: object) -> Image:
    if not isinstance(entry, dict) or not {"reference", "archive"} <= set(entry):
        raise InputError(f"{file}: {name}: must have reference and archive")
    ground = file.parent / str(entry["ground"]) if "ground" in entry else None
    image = Image(name, str(entry["reference"]), file.parent / str(entry["archive"]), ground)
    if "@sha256:" not in image.reference:
        raise InputError(f"{file}: {name}.reference: {image.reference!r} must be REPOSITORY@sha256:...")
    for key, archive in (("archive", image.archive), ("ground", image.ground)):
        if archive and not archive.is_file():
            raise InputError(f"{file}: {name}.{key}: {archive} does not exist; build the images again: make images")
    return image


def sandbox_of(images: Iterable[Image]) -> str:
    """Reference of the pause image."""
    return next(image.reference for image in images if image.name == SANDBOX)
