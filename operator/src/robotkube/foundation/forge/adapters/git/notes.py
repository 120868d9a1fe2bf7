"""Git notes of one repository of the forge: read and written in a bare clone, pushed fast-forward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pygit2

from robotkube.errors import UnavailableError
from robotkube.foundation.forge.adapters.git.connection import EMAIL_DOMAIN, GitConnection, open_clone
from robotkube.writes import writes

REFERENCE = "refs/notes/robotkube"


class GitNotes:
    """The port Notes for `<organisation>/<name>`; the clone stands in `folder` and can be lost at any time.

    UnavailableError: the forge does not answer, or another writer was faster; a caller may try again."""

    def __init__(self, url: str, repository: str, username: str, password: str, folder: Path) -> None:
        self._account = (username, password)
        self._repository = open_clone(folder, url, repository)

    def missing(self, commits: Sequence[str]) -> Sequence[str]:
        """Those of the commits that have no note at the forge yet."""
        try:
            remote = self._repository.remotes["origin"]
            remote.fetch([f"+{REFERENCE}:{REFERENCE}"], callbacks=GitConnection(self._account))
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise UnavailableError(f"notes: fetch: {error}") from error
        return [commit for commit in commits if not self._has(commit)]

    def _has(self, commit: str) -> bool:
        try:
            self._repository.lookup_note(commit, REFERENCE)
        except KeyError:
            return False
        return True

    @writes("git")
    def add(self, texts: Mapping[str, str]) -> None:
        """Give every commit its note and push them together."""
        who = pygit2.Signature(self._account[0], f"{self._account[0]}@{EMAIL_DOMAIN}")
        for commit, text in texts.items():
            self._repository.create_note(f"{text}\n", who, who, commit, REFERENCE, True)
        connection = GitConnection(self._account)
        try:
            self._repository.remotes["origin"].push([f"{REFERENCE}:{REFERENCE}"], callbacks=connection)
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise UnavailableError(f"notes: push: {error}") from error
        if connection.refusal:
            raise UnavailableError(f"notes: push refused: {connection.refusal}")
