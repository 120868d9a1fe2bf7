"""A shelf for exports: one temporary file beside the target."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


class FileShelf:
    """To be closed; the file has no name and is gone then. OSError: there is no room in `folder`."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # lives as long as this object
        self._end = 0

    def put(self, data: bytes) -> int:
        """See the port."""
        place = self._end
        self._file.write(data)
        self._end += len(data)
        return place

    def get(self, place: int, size: int) -> bytes:
        """See the port."""
        self._file.flush()
        return os.pread(self._file.fileno(), size, place)

    def close(self) -> None:
        """Forget everything."""
        self._file.close()
