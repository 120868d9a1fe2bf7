"""The last list of what may run as a JSON file, beside the policies that were made of it."""

from __future__ import annotations

import json
import logging
from pathlib import Path

from robotkube.errors import InputError
from robotkube.registry.admission.core.listing import AllowedVersions

log = logging.getLogger(__name__)


class ListingFile:
    """The port ListingMemory on a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> AllowedVersions:
        """The list; of a file that cannot be read none, and the log says so: the catalogue has the next."""
        if not self._path.is_file():
            return AllowedVersions()
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
            listing = AllowedVersions(_words(document["charts"]), _words(document["images"]))
            listing.with_platform(())  # refuses what is no digest
            return listing
        except (OSError, ValueError, KeyError, TypeError, InputError) as error:
            log.warning("admission: the last list is unusable path=%s problem=%r", self._path, error)
            return AllowedVersions()

    def save(self, listing: AllowedVersions) -> None:
        """Keep the list; the file is whole at every moment."""
        part = self._path.with_name(f".{self._path.name}.part")
        part.write_text(json.dumps({"charts": listing.charts, "images": listing.verified}, indent=1), encoding="utf-8")
        part.replace(self._path)


def _words(value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
        raise ValueError("must be a list of texts")
    return tuple(value)
