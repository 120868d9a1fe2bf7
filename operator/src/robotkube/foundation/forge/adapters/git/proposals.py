"""Commits that are proposed: made in memory on a fetched commit, opened as pull requests by one AGit push.

`git push origin <commit>:refs/for/main -o topic=... -o title=... -o description=...` opens the pull request;
the account needs read access to the repository only. Works on the bare clone that a GitClone keeps up to date.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pygit2
from pygit2.enums import FileMode

from robotkube.errors import AccountRefusedError, RefusalError, RobotKubeError, UnavailableError
from robotkube.foundation.forge.adapters.git.commit_objects import new_objects
from robotkube.foundation.forge.adapters.git.connection import (
    EMAIL_DOMAIN,
    ORIGIN,
    GitConnection,
    look_up,
    what_failed,
)
from robotkube.foundation.forge.adapters.git.refusals import in_one_line, refusal_words, refused_status
from robotkube.foundation.forge.core.commit_objects import CommitObjects
from robotkube.writes import writes

DESCRIPTION_BYTES_MAX = 48 * 1024  # the forge takes 64 KiB per push option; base64 makes a third more
TITLE_CHARACTERS_MAX = 250  # forges keep 255 at most; a push option that is too large ends the push without an answer
BRANCHES = "robotkube"
PROPOSAL_REFERENCE = "refs/proposals-of-mine/current"

_NUMBER = re.compile(r"/pulls/(\d+)\b")


class ProposalWriter:
    """The port Proposals on the bare clone in `folder`. `author` is the name in the commits; `clock` gives seconds.

    `open_pull_request(branch, title, body)` is for forges without AGit: the commit goes to `robotkube/<topic>` and that
    opens its pull request; such an account must be allowed to push branches. `send_objects` gets the commit
    objects of a proposal before it is pushed; it returns at once, and what becomes of that changes nothing here."""

    def __init__(
        self,
        folder: Path,
        username: str,
        password: str,
        author: str,
        clock: Callable[[], float],
        branch: str = "main",
        open_pull_request: Callable[[str, str, str], int] | None = None,
        send_objects: Callable[[CommitObjects], None] | None = None,
    ) -> None:
        self._repository = pygit2.Repository(str(folder))
        self._account = (username, password)
        self._author = author
        self._clock = clock
        self._branch = branch
        self._open = open_pull_request
        self._send_objects = send_objects

    def commit(
        self, parent: str, changes: Mapping[str, str | None], message: str, merged: str = "", author: str = ""
    ) -> str:
        """Make a commit on `parent` and return its id; nothing outside the object store changes. `merged`: a second
        parent, which gives nothing but its place in history; `author`: the account whose change it is, when it is
        another's."""
        base = self._lookup(parent)
        tree = self._edited(base.tree, _nested(changes))
        now = int(self._clock())
        committer = pygit2.Signature(self._author, f"{self._author}@{EMAIL_DOMAIN}", now, 0)
        signature = pygit2.Signature(author, f"{author}@{EMAIL_DOMAIN}", now, 0) if author else committer
        if tree is None:
            tree = self._repository.TreeBuilder().write()
        parents = [base.id, *([self._lookup(merged).id] if merged else [])]
        return str(self._repository.create_commit(None, signature, committer, message, tree, parents))

    def _edited(self, tree: pygit2.Tree | None, changes: Mapping[str, Any]) -> pygit2.Oid | None:
        """`tree` with the nested changes applied; None when nothing is left of it."""
        builder = self._repository.TreeBuilder(tree) if tree is not None else self._repository.TreeBuilder()
        for name, change in changes.items():
            present = tree[name] if tree is not None and name in tree else None
            if isinstance(change, Mapping):
                folder = self._edited(present if isinstance(present, pygit2.Tree) else None, change)
                self._put(builder, name, folder, FileMode.TREE)
            else:
                blob = None if change is None else self._repository.create_blob(change.encode())
                self._put(builder, name, blob, FileMode.BLOB)
        return builder.write() if len(builder) else None

    @staticmethod
    def _put(builder: Any, name: str, content: pygit2.Oid | None, mode: FileMode) -> None:
        if content is not None:
            builder.insert(name, content, mode)
        elif builder.get(name) is not None:
            builder.remove(name)

    @writes("git")
    def propose(self, commit: str, topic: str, title: str, body: str) -> int | None:
        """Push `commit` for review; the pull request's number when the forge names it. A title is cut to what forges
        keep.

        UnavailableError when the forge does not answer; AccountRefusedError when it does not know the account;
        RefusalError, with its words, when it refuses the push, which no further attempt changes."""
        git_commit = self._lookup(commit)
        self._repository.references.create(PROPOSAL_REFERENCE, git_commit.id, force=True)
        if self._send_objects is not None and (objects := new_objects(self._repository, git_commit)) is not None:
            self._send_objects(objects)
        title = title if len(title) <= TITLE_CHARACTERS_MAX else f"{title[: TITLE_CHARACTERS_MAX - 1]}…"
        text = body.encode()[:DESCRIPTION_BYTES_MAX].decode(errors="ignore")
        if self._open is None:
            options = [
                f"topic={topic}",
                f"title={title}",
                "description={base64}" + base64.b64encode(text.encode()).decode(),
            ]
            numbers = _NUMBER.findall(self._push(topic, f"refs/for/{self._branch}", options))
            return int(numbers[-1]) if numbers else None
        self._push(topic, f"refs/heads/{BRANCHES}/{topic}", [], force=True)
        return self._open(f"{BRANCHES}/{topic}", title, text)

    def _push(self, topic: str, target: str, options: list[str], force: bool = False) -> str:
        """Push the commit; the forge's output about it. `force`: a branch of one's own may be pushed again."""
        connection = GitConnection(self._account)
        specification = f"{'+' if force else ''}{PROPOSAL_REFERENCE}:{target}"
        try:
            self._repository.remotes[ORIGIN].push([specification], callbacks=connection, push_options=options or None)
        except (pygit2.GitError, PermissionError, OSError) as error:
            raise self._failed(topic, error) from error
        if connection.refusal:
            raise _refused(topic, ": ".join(filter(None, (connection.refusal, in_one_line(connection.output)))))
        return connection.output

    def _failed(self, topic: str, error: Exception) -> RobotKubeError:
        """The error for what libgit2 raised: the forge is away, does not know the account, or refuses."""
        url = str(self._repository.remotes[ORIGIN].url)
        words = what_failed(error, url)
        if isinstance(error, PermissionError) or "authentication" in words:
            words = f"the forge refuses account {self._account[0]}: its password is wrong, or it is not made yet"
            return AccountRefusedError(f"proposal {topic}: push: {words}")
        if status := refused_status(error):
            return _refused(topic, refusal_words(status, url, self._account))
        return UnavailableError(f"proposal {topic}: push: {words}")

    def _lookup(self, commit: str) -> pygit2.Commit:
        return look_up(self._repository, commit, "proposals")


def _refused(topic: str, words: str) -> RefusalError:
    return RefusalError("ProposalRefused", f"the forge refused proposal {topic}: {words}")


def _nested(changes: Mapping[str, str | None]) -> dict[str, Any]:
    """`{a/b/c: text}` as `{a: {b: {c: text}}}`. What is removed yields to a folder in its place, or to a file in the
    place of its folder."""
    written = {path for path, text in changes.items() if text is not None}
    above = {folder for path in written for folder in _folders(path)}
    root: dict[str, Any] = {}
    for path, text in changes.items():
        if text is None and (path in above or not written.isdisjoint(_folders(path))):
            continue
        *folders, name = path.split("/")
        place = root
        for folder in folders:
            place = place.setdefault(folder, {})
        place[name] = text
    return root


def _folders(path: str) -> set[str]:
    """The folders above a path."""
    return {path[:index] for index, character in enumerate(path) if character == "/"}
