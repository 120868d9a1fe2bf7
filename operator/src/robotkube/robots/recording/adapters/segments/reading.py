"""Reading single messages and whole files back from several mounted volume claims."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from robotkube.errors import UnavailableError
from robotkube.robots.recording.adapters.segments.records import MESSAGE, MESSAGE_OPCODE, NOTES, RECORD
from robotkube.robots.recording.core.documents import SegmentPlace


class McapSegmentReader:
    """Reads single messages from several mounted volume claims. `roots`: volume `<node>/<volume claim>` -> folder."""

    def __init__(self, roots: Mapping[str, Path]) -> None:
        self._roots = dict(roots)

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        """The message's bytes, straight from its record; UnavailableError says which volume, file or record fails."""
        where = f"{volume}: {place.segment} at {place.offset}"
        path = self._path(volume, place.segment, where)
        try:
            with path.open("rb") as file:
                file.seek(place.offset)
                record = file.read(RECORD.size + MESSAGE.size + size)
        except OSError as error:
            raise UnavailableError(f"{where}: {error.strerror}") from error
        if len(record) < RECORD.size + MESSAGE.size + size:
            raise UnavailableError(f"{where}: the file ends within the message")
        opcode, length = RECORD.unpack_from(record)
        if opcode != MESSAGE_OPCODE or length != MESSAGE.size + size:
            raise UnavailableError(f"{where}: there is no message of {size} bytes")
        return record[RECORD.size + MESSAGE.size :]

    def digest(self, volume: str, segment: str) -> tuple[str, int]:
        """SHA-256 and size of the whole file; UnavailableError as `read`."""
        where = f"{volume}: {segment}"
        try:
            with self._path(volume, segment, where).open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest(), file.tell()
        except OSError as error:
            raise UnavailableError(f"{where}: {error.strerror}") from error

    def notes(self, volume: str, recording: str) -> Mapping[str, Sequence[str]]:
        """The lines of `<recording>/<life>.manifest`, by life."""
        where = f"{volume}: {recording}"
        try:
            return noted_lines(self._path(volume, recording, where))
        except OSError as error:
            raise UnavailableError(f"{where}: {error.strerror}") from error

    def _path(self, volume: str, segment: str, where: str) -> Path:
        root = self._roots.get(volume)
        if root is None:
            node, _, name = volume.partition("/")
            raise UnavailableError(f"{where}: volume claim {name} of node {node} is not within reach")
        path = (root / segment).resolve()
        if not path.is_relative_to(root.resolve()):
            raise UnavailableError(f"{where}: leads out of the volume")
        return path


def noted_lines(folder: Path) -> Mapping[str, Sequence[str]]:
    """The lines of the files `<life>.manifest` in a recording's folder, by life; OSError when one cannot be read."""
    files = sorted(folder.glob(f"*{NOTES}"))
    return {file.stem: file.read_text(encoding="utf-8", errors="replace").splitlines() for file in files}
