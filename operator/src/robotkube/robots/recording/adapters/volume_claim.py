"""A mounted volume claim as recordings use it: segments, their repair, and the spool."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from robotkube.robots.recording.adapters.bson_spool import BsonSpool
from robotkube.robots.recording.adapters.segments import McapRepair, McapSegments
from robotkube.robots.recording.adapters.segments.reading import noted_lines
from robotkube.robots.recording.adapters.segments.records import NOTES
from robotkube.robots.recording.adapters.segments.writing import synchronise_folder


class MountedVolumeClaim:
    """A volume claim mounted at `root`; PermissionError when nobody may write there. `owner` names spool files."""

    def __init__(self, root: Path, owner: str, clock_ns: Callable[[], int]) -> None:
        if not os.access(root, os.W_OK):
            raise PermissionError(f"{root} is no folder that can be written; is the volume claim mounted there?")
        self._root = root
        self._owner = owner
        self._clock_ns = clock_ns

    def segments(self, recording: str) -> McapSegments:
        """A new writer for a recording."""
        return McapSegments(self._root, recording, self._clock_ns)

    def spool(self) -> BsonSpool:
        """The spool on the volume."""
        return BsonSpool(self._root, self._owner, self._clock_ns)

    def repairs(self) -> McapRepair:
        """The repair of files whose writers are gone."""
        return McapRepair(self._root)

    def note(self, recording: str, life: str, lines: Sequence[str]) -> None:
        """Append the lines to `<recording>/<life>.manifest`, and synchronise."""
        path = self._root / recording / f"{life}{NOTES}"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab") as file:
            size = file.tell()
            try:
                file.write("".join(f"{line}\n" for line in lines).encode())
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                with suppress(OSError):
                    file.truncate(size)  # on a full disk: half a line would stand before the next attempt
                raise
        synchronise_folder(path.parent)

    def noted_of(self, recording: str) -> Mapping[str, Sequence[str]]:
        """The lines of the recording's files `<life>.manifest`, by life."""
        return noted_lines(self._root / recording)
