"""A repository whose whole history is read, from a clone on this machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from robotkube.foundation.forge.core.histories import HistoryCommit, NoteHistory


class RepositoryHistory(Protocol):
    """Main of one repository, and its notes. InputError when the clone cannot be read."""

    def commits(self, previous: Mapping[str, str]) -> Sequence[HistoryCommit]:
        """Main's commits along first parents, oldest first; empty when there is no main.

        `previous`: commit -> where main stood before it moved there. What lies between came with that commit: it is
        left out, and the commit's changes are those of all of it. A `previous` that is no ancestor does not count."""
        ...

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Path -> text of every ordinary text file below `folders` in `commit`."""
        ...

    def brought(self, commit: str) -> int:
        """The number of commits that a merge commit brings besides those of its first parent."""
        ...

    def notes(self, reference: str) -> NoteHistory:
        """The notes below a reference; empty when there are none."""
        ...
