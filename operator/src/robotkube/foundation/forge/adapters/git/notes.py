"""Git notes of one repository of the forge: read and written in a bare clone, pushed fast-forward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pygit2

from robotkube.errors import UnavailableError
from robotkube.foundation.forge.adapters.git.connection import (
    EMAIL_DOMAIN,
    ORIGIN,
    GitConnection,
    fetch,
    open_clone,
    what_failed,
)
from robotkube.writes import writes

REFERENCE = "refs/notes/robotkube"
ALL_NOTES = "+refs/notes/*:refs/notes/*"


class GitNotes:
    """The ports Notes and NoteTexts for `<organisation>/<name>`, of one `reference`; the clone stands in `folder` and
    can be lost at any time.

    UnavailableError: the forge does not answer, or another writer was faster; a caller may try again."""

    def __init__(
        self, url: str, repository: str, username: str, password: str, folder: Path, reference: str = REFERENCE
    ) -> None:
        self._account = (username, password)
        self._url = url
        self._reference = reference
        self._repository = open_clone(folder, url, repository)

    def missing(self, commits: Sequence[str]) -> Sequence[str]:
        """Those of the commits that have no note at the forge yet."""
        self._fetch()
        return [commit for commit in commits if self._text(commit) is None]

    def texts(self, commits: Sequence[str]) -> Mapping[str, str]:
        """The notes that these commits have at the forge, without the newline at their end."""
        self._fetch()
        notes = {commit: self._text(commit) for commit in commits}
        return {commit: text.removesuffix("\n") for commit, text in notes.items() if text is not None}

    def _fetch(self) -> None:
        try:
            fetch(self._repository, [ALL_NOTES], self._account)
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise UnavailableError(f"notes: fetch: {what_failed(error, self._url)}") from error

    def _text(self, commit: str) -> str | None:
        """The text of a commit's note; None when it has none, empty when its note is no text."""
        try:
            return str(self._repository.lookup_note(commit, self._reference).message)
        except KeyError:
            return None
        except UnicodeDecodeError:
            return ""

    def tip(self, reference: str) -> str:
        """The tip of a reference with notes as it was fetched last; empty when there is none."""
        branch = self._repository.references.get(reference)
        return str(branch.target) if branch else ""

    @writes("git")
    def add(self, texts: Mapping[str, str]) -> None:
        """Give every commit its note and push them together."""
        who = pygit2.Signature(self._account[0], f"{self._account[0]}@{EMAIL_DOMAIN}")
        for commit, text in texts.items():
            self._repository.create_note(f"{text}\n", who, who, commit, self._reference, True)
        connection = GitConnection(self._account)
        try:
            self._repository.remotes[ORIGIN].push([f"{self._reference}:{self._reference}"], callbacks=connection)
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise UnavailableError(f"notes: push: {what_failed(error, self._url)}") from error
        if connection.refusal:
            raise UnavailableError(f"notes: push refused: {connection.refusal}")
