"""Images that are built: an archive, its bill and a record of it in one folder each, and the lock that names them."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.registry.images.adapters import bills
from robotkube.registry.images.adapters.normalising import NormalImage

REPOSITORY = "forge.robotkube.svc.cluster.local:3000/robotkube"
ARCHIVE, RECORD = "image.tar", "image.json"


@dataclass(frozen=True)
class BuiltImage:
    """An image archive on this machine: `reference` is repository@digest, `size` the bytes of its layers, `bill` its
    software bill of materials, `ground` the archive that has those of its layers that `archive` has not."""

    name: str
    reference: str
    archive: Path
    bill: Path
    size: int
    layers: dict[str, int]
    ground: Path | None = None

    @property
    def digest(self) -> str:
        return self.reference.rpartition("@")[2]


def is_built(place: Path) -> bool:
    """Return whether the folder holds a finished image."""
    return (place / RECORD).is_file()


def read_record(place: Path) -> dict[str, Any]:
    """What is known of the image in a folder."""
    record: dict[str, Any] = json.loads((place / RECORD).read_bytes())
    return record


def write_record(place: Path, image: NormalImage, **more: Any) -> None:
    """Write the record beside the archive."""
    layers = {layer.digest: layer.size for layer in image.layers}
    record = {"digest": image.digest, "size": image.size, "layers": layers, **more}
    (place / RECORD).write_text(json.dumps(record, indent=1), encoding="utf-8")


def read_built(name: str, place: Path, ground: Path | None = None) -> BuiltImage:
    """The image in a folder."""
    record = read_record(place)
    return BuiltImage(
        name=name,
        reference=f"{REPOSITORY}/{name}@{record['digest']}",
        archive=place / ARCHIVE,
        bill=place / bills.FILE,
        size=record["size"],
        layers=record["layers"],
        ground=ground,
    )


def write_lock(lock: Path, built: dict[str, BuiltImage], names: Collection[str]) -> None:
    """Name every image of `names` that is built, also those of earlier runs that this one did not touch."""
    known = json.loads(lock.read_bytes()) if lock.is_file() else {}
    kept = {name: entry for name, entry in known.items() if name in names and _is_there(entry)}
    new = {name: _lock_entry(image) for name, image in built.items()}
    part = lock.with_suffix(".part")
    part.write_text(json.dumps(kept | new, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    part.replace(lock)


def _is_there(entry: dict[str, Any]) -> bool:
    return all(Path(entry[key]).is_file() for key in ("archive", "ground") if key in entry)


def _lock_entry(image: BuiltImage) -> dict[str, Any]:
    files = {"archive": str(image.archive), "bill": str(image.bill)}
    files |= {"ground": str(image.ground)} if image.ground else {}
    return {"reference": image.reference, **files, "size": image.size}
