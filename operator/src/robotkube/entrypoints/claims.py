"""A mounted claim as recordings use it: segments, what repairs them, and the spool."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from robotkube.adapters.segments_mcap import McapRepair, McapSegments
from robotkube.adapters.spool_bson import BsonSpool


class VolumeClaim:
    """A claim mounted at `root`; PermissionError when nobody may write there. `owner` names files of the spool."""

    def __init__(self, root: Path, owner: str, clock_ns: Callable[[], int]) -> None:
        if not os.access(root, os.W_OK):
            raise PermissionError(f"{root} is no folder that can be written; is the claim mounted there?")
        self._root, self._owner, self._clock_ns = root, owner, clock_ns

    def segments(self, recording: str) -> McapSegments:
        """A new writer for a recording."""
        return McapSegments(self._root, recording, self._clock_ns)

    def spool(self) -> BsonSpool:
        """The spool."""
        return BsonSpool(self._root, self._owner, self._clock_ns)

    def repairs(self) -> McapRepair:
        """What finishes files of writers that are gone."""
        return McapRepair(self._root)
