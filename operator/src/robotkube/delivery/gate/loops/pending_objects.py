"""Commit objects that proposers sent to the gate, until the forge names their commit.

They wait in memory, each proposer's for its own proposals: the clone receives what the forge has named as the head of a
pull request, and nothing else.
"""

from __future__ import annotations

import threading

from robotkube.foundation.forge.core.commit_objects import CommitObjects

KEPT_MAX = 4  # of each proposer, of BYTES_MAX each at most; of more, the oldest are fetched when their turn comes


class PendingObjects:
    """The newest objects of each account, by commit; for any thread."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[str, CommitObjects]] = {}  # account -> commit
        self._lock = threading.Lock()

    def keep(self, account: str, objects: CommitObjects) -> None:
        """Keep objects as what `account` sent."""
        with self._lock:
            kept = self._kept.setdefault(account, {})
            kept.pop(objects.commit, None)
            kept[objects.commit] = objects
            while len(kept) > KEPT_MAX:
                del kept[next(iter(kept))]

    def pop(self, account: str, commit: str) -> CommitObjects | None:
        """Remove and return what `account` sent with that commit; None when there is nothing."""
        with self._lock:
            return self._kept.get(account, {}).pop(commit, None)
