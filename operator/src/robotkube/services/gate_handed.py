"""Objects that proposers handed to the gate, until the forge names their commit.

They wait in memory: the clone takes in what the forge has named as the head of a pull request, and nothing else.
"""

from __future__ import annotations

import threading

from robotkube.domain.handed_objects import HandedObjects

KEPT_MAX = 16  # of BYTES_MAX each at most; of more, the oldest are fetched when their turn comes


class Handed:
    """From any thread."""

    def __init__(self) -> None:
        self._kept: dict[str, HandedObjects] = {}
        self._lock = threading.Lock()

    def keep(self, handed: HandedObjects) -> None:
        """They may be asked for."""
        with self._lock:
            self._kept.pop(handed.commit, None)
            self._kept[handed.commit] = handed
            while len(self._kept) > KEPT_MAX:
                del self._kept[next(iter(self._kept))]

    def take(self, commit: str) -> HandedObjects | None:
        """What came with that commit, once."""
        with self._lock:
            return self._kept.pop(commit, None)
