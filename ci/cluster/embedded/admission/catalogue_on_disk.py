"""The catalogue's main, read from the forge's volume on this machine: no account, no network, and no cost while nothing
changes.

What is read there is believed no more than what the forge would answer: the list follows from signatures.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pygit2

from robotkube.errors import UnavailableError
from robotkube.foundation.forge.adapters.git import GitClone
from robotkube.foundation.forge.ports.repositories import Commit

REPOSITORY = "robotkube/catalogue"
REFERENCES = ("refs/heads/main", "packed-refs")  # the files that a moved main changes
Signature = tuple[tuple[int, int, int], ...]


class CatalogueOnDisk:
    """Port CatalogueHistory. `find` gives the folder of the forge's repositories, which changes when the forge gets
    another volume; it raises UnavailableError while there is none. `clones`: folder for clones."""

    def __init__(self, find: Callable[[], Path], clones: Path) -> None:
        # The files belong to the account of the forge's pod. Nothing of them is run: hooks are for whoever pushes.
        pygit2.settings.owner_validation = False
        self._find = find
        self._clones = clones
        self._place = Path()
        self._clone: GitClone | None = None
        self._seen: Signature = ()

    def fetch(self) -> str:
        """Main's tip, brought here; see RepositoryFiles. Nothing but three stats while main stays."""
        place = self._find()
        if self._clone is None or place != self._place:
            name = hashlib.sha256(str(place).encode()).hexdigest()[:16]
            self._clone = GitClone(f"file://{place}", REPOSITORY, "", "", self._clones / name)
            self._place = place
            self._seen = ()
        signature = _signature(place / f"{REPOSITORY}.git")
        if signature != self._seen:
            self._clone.fetch()
            self._seen = signature
        return self._clone.tip

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """See RepositoryFiles."""
        return self._fetched().files(commit, folders)

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        """See MainHistory."""
        return self._fetched().irregular(commit, folders)

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        """See MainHistory."""
        return self._fetched().headers(since, commits_max)

    def commit(self, commit: str) -> Commit:
        """See CatalogueHistory."""
        return self._fetched().commit(commit)

    def _fetched(self) -> GitClone:
        if self._clone is None:
            raise UnavailableError("the catalogue has not been fetched yet")
        return self._clone


def _signature(repository: Path) -> Signature:
    """What changes when a reference does: a file is replaced, never written in place. UnavailableError without it."""
    if not (repository / "HEAD").is_file():
        raise UnavailableError(f"{repository}: the forge has no catalogue yet")
    seen = []
    for name in REFERENCES:
        try:
            status = (repository / name).stat()
            seen.append((status.st_ino, status.st_mtime_ns, status.st_size))
        except FileNotFoundError:
            seen.append((0, 0, 0))
    return tuple(seen)
