"""The staging file of an export: one temporary file beside the target."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


class TemporaryStagingFile:
    """A temporary file in `folder` without a name, gone when it is closed. OSError: there is no space."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # lives as long as this object
        self._end = 0

    def put(self, data: bytes) -> int:
        """Keep bytes; their place."""
        place = self._end
        self._file.write(data)
        self._end += len(data)
        return place

    def get(self, place: int, size: int) -> bytes:
        """The bytes that were kept at a place."""
        self._file.flush()
        return os.pread(self._file.fileno(), size, place)

    def close(self) -> None:
        """Close the file, which forgets everything."""
        self._file.close()
