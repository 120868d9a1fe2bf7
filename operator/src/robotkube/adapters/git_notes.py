"""Git notes of one repository of the forge: read and written in a bare clone, pushed fast-forward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pygit2

from robotkube.domain.errors import UnavailableError
from robotkube.ports.writing import writes

REFERENCE = "refs/notes/robotkube"
EMAIL_DOMAIN = "robotkube.invalid"


class _Callbacks(pygit2.RemoteCallbacks):
    """Password once per connection; the server's word on the pushed reference."""

    def __init__(self, username: str, password: str) -> None:
        super().__init__()
        self._username, self._password, self._asked = username, password, 0
        self.refusal = ""

    def credentials(self, url: str, username_from_url: str | None, allowed_types: Any) -> Any:
        self._asked += 1
        if self._asked > 2:
            raise PermissionError(f"the forge refused the password of account {self._username}")
        return pygit2.UserPass(self._username, self._password)

    def push_update_reference(self, refname: str, message: str | None) -> None:
        if message:
            self.refusal = message


class GitNotes:
    """The port Notes for `<organisation>/<name>`; the clone stands in `folder` and can be lost at any time.

    UnavailableError: the forge does not answer, or somebody else was faster; a loop may try again."""

    def __init__(self, url: str, repository: str, username: str, password: str, folder: Path) -> None:
        self._account = (username, password)
        self._repository = pygit2.init_repository(str(folder), bare=True)
        if "origin" not in list(self._repository.remotes.names()):
            self._repository.remotes.create("origin", f"{url}/{repository}.git")
        self._repository.remotes.set_url("origin", f"{url}/{repository}.git")

    def missing(self, commits: Sequence[str]) -> Sequence[str]:
        """Those of the commits that have no note at the forge yet."""
        try:
            remote = self._repository.remotes["origin"]
            remote.fetch([f"+{REFERENCE}:{REFERENCE}"], callbacks=_Callbacks(*self._account))
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
        callbacks = _Callbacks(*self._account)
        try:
            self._repository.remotes["origin"].push([f"{REFERENCE}:{REFERENCE}"], callbacks=callbacks)
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise UnavailableError(f"notes: push: {error}") from error
        if callbacks.refusal:
            raise UnavailableError(f"notes: push refused: {callbacks.refusal}")
