"""A person's own clone of a repository: what a commit of it changes, another commit with the same files, one push."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import pygit2

from robotkube.errors import InputError, RefusalError, UnavailableError
from robotkube.foundation.forge.adapters.git.connection import EMAIL_DOMAIN, GitConnection, what_failed
from robotkube.foundation.forge.adapters.git.refusals import refusal_words, refused_status
from robotkube.writes import writes


@dataclass(frozen=True)
class LocalChange:
    """A commit of one's own: its only parent, its tree, and the first line of its message."""

    parent: str
    tree: str
    subject: str


class WorkingClone:
    """The clone in `folder` or above it; InputError when there is none."""

    def __init__(self, folder: Path) -> None:
        repository = pygit2.discover_repository(str(folder))
        if repository is None:
            raise InputError(f"{folder}: is in no clone of a repository; see --repository")
        self._where = str(folder)
        self._repository = pygit2.Repository(repository)

    def change(self, revision: str) -> LocalChange:
        """The commit that `revision` names."""
        try:
            commit = self._repository.revparse_single(revision).peel(pygit2.Commit)
        except (KeyError, ValueError, pygit2.GitError) as error:
            raise InputError(f"{self._where}: {revision!r} names no commit here") from error
        if len(commit.parents) != 1:
            count = len(commit.parents)
            raise InputError(f"{self._where}: {revision!r} has {count} parents; make one commit on main's tip")
        return LocalChange(str(commit.parent_ids[0]), str(commit.tree_id), commit.message.partition("\n")[0])

    def differences(self, parent: str, tree: str) -> Sequence[str]:
        """What `tree` changes of the files of commit `parent`, as a patch has it, line by line."""
        before = self._commit(parent).tree
        after = self._tree(tree)
        return (before.diff_to_tree(after).patch or "").splitlines()

    def file(self, commit: str, path: str) -> str:
        """A file of a commit as text; empty when it is not there."""
        tree = self._commit(commit).tree
        entry = tree[path] if path in tree else None  # noqa: SIM401 - a Tree has no get
        return entry.data.decode(errors="replace") if isinstance(entry, pygit2.Blob) else ""

    def commit(self, parent: str, tree: str, message: str, author: str, seconds: int) -> str:
        """Make a commit with these files; its id. No branch moves."""
        who = pygit2.Signature(author, f"{author}@{EMAIL_DOMAIN}", seconds, 0)
        files = self._tree(tree).id
        return str(self._repository.create_commit(None, who, who, message, files, [self._commit(parent).id]))

    @writes("git")
    def push(self, url: str, account: tuple[str, str], commit: str, reference: str, options: Sequence[str]) -> None:
        """Push a commit, never by force; done when it is there. RefusalError with the forge's words; UnavailableError
        when it is away."""
        name = "refs/pushes/emergency"
        self._repository.references.create(name, commit, force=True)
        remote = self._repository.remotes.create_anonymous(url)
        connection = GitConnection(account)
        try:
            heads = self._repository.remotes.create_anonymous(url).list_heads(callbacks=GitConnection(account))
            if any((head.name, str(head.oid)) == (reference, commit) for head in heads):
                return  # it is there, such as by a push that was cut off
            remote.push([f"{name}:{reference}"], callbacks=connection, push_options=list(options))
        except PermissionError as error:
            raise RefusalError("AccountRefused", f"{url}: {error}") from error
        except (pygit2.GitError, OSError) as error:
            if "non-fastforward" in str(error) or "not present locally" in str(error):
                raise RefusalError(
                    "MainMoved", f"{url}: main has moved; sign a commit that stands on its tip"
                ) from error
            if status := refused_status(error):
                raise RefusalError("PushRefused", f"{url}: {refusal_words(status, url, account)}") from error
            raise UnavailableError(f"{url}: push: {what_failed(error, url)}") from error
        finally:
            self._repository.references.delete(name)
        if connection.refusal:
            raise RefusalError("PushRefused", f"{url}: {connection.refusal}\n{connection.output.strip()}")

    def _commit(self, identifier: str) -> pygit2.Commit:
        commit = self._repository.get(identifier)
        return commit if isinstance(commit, pygit2.Commit) else self._missing(identifier)

    def _tree(self, identifier: str) -> pygit2.Tree:
        tree = self._repository.get(identifier)
        return tree if isinstance(tree, pygit2.Tree) else self._missing(identifier)

    def _missing(self, identifier: str) -> NoReturn:
        problem = "is not here; fetch main and the branch that has the change"
        raise InputError(f"{self._where}: {identifier[:12]} {problem}")
