"""Objects that proposers handed to the gate, until the forge names their commit.

They wait in memory, each proposer's for its own proposals: the clone takes in what the forge has named as the head of a
pull request, and nothing else.
"""

from __future__ import annotations

import threading

from robotkube.domain.handed_objects import HandedObjects

KEPT_MAX = 4  # of each proposer, of BYTES_MAX each at most; of more, the oldest are fetched when their turn comes


class Handed:
    """From any thread."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[str, HandedObjects]] = {}  # account -> commit
        self._lock = threading.Lock()

    def keep(self, account: str, handed: HandedObjects) -> None:
        """They may be asked for, as what `account` handed over."""
        with self._lock:
            kept = self._kept.setdefault(account, {})
            kept.pop(handed.commit, None)
            kept[handed.commit] = handed
            while len(kept) > KEPT_MAX:
                del kept[next(iter(kept))]

    def take(self, account: str, commit: str) -> HandedObjects | None:
        """What `account` handed over with that commit, once."""
        with self._lock:
            return self._kept.get(account, {}).pop(commit, None)
