"""The whole history of a repository, read from a bare clone on this machine (`git clone --mirror`), and such clones
fetched from the forge."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import pygit2
from pygit2.enums import FetchPrune

from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.foundation.forge.adapters.git.clones import GitClone
from robotkube.foundation.forge.adapters.git.connection import fetch, open_clone, what_failed
from robotkube.foundation.forge.adapters.git.notes import ALL_NOTES
from robotkube.foundation.forge.core.histories import HistoryCommit, NoteEdit, NoteHistory

COMMITS_MAX = 100_000
NOTE_BYTES_MAX = 256 * 1024
BROUGHT_MAX = 1000
HEX_DIGITS = 40


class GitHistory:
    """The port RepositoryHistory for the clone in `folder`, bare or not."""

    def __init__(self, folder: Path, branch: str = "main") -> None:
        """InputError when there is no clone, or one whose history was cut off."""
        try:
            self._repository = pygit2.Repository(str(folder))
        except pygit2.GitError as error:
            raise InputError(f"{folder}: no clone of a Git repository; make it with `git clone --mirror`") from error
        if self._repository.is_shallow:
            raise InputError(
                f"{folder}: a shallow clone, its history is cut off; clone it whole, with `git clone --mirror`"
            )
        self._where = str(folder)
        self._clone = GitClone("", "", "", "", Path(self._repository.path), branch, remote=False)

    def commits(self, previous: Mapping[str, str]) -> Sequence[HistoryCommit]:
        """Main's commits along first parents, or to the `previous` one where that is known, oldest first."""
        newest_first: list[HistoryCommit] = []
        commit = self._clone.tip
        while commit:
            if len(newest_first) == COMMITS_MAX:
                raise InputError(f"{self._where}: main has more than {COMMITS_MAX} commits")
            before = self._before(commit, previous.get(commit, ""))
            newest_first.append(self._read(commit, before))
            commit = before
        return newest_first[::-1]

    def _before(self, commit: str, previous: str) -> str:
        """Main's commit before this one; empty when it is the first."""
        parents = [str(parent) for parent in self._commit(commit).parent_ids]
        if previous in parents[:1] or not parents:
            return "".join(parents[:1])
        known = isinstance(self._repository.get(previous), pygit2.Commit) if previous else False
        return previous if known and self._repository.descendant_of(commit, previous) else parents[0]

    def _read(self, commit: str, before: str) -> HistoryCommit:
        git_commit = self._commit(commit)
        changes: Mapping[str, str | None] = {}
        irregular: tuple[str, ...] = ()
        problem = ""
        try:
            read = self._clone.changes_since(commit, before) if before else self._clone.commit(commit)
            changes, irregular = read.changes, read.irregular
        except DocumentError as error:
            problem = "; ".join(error.problems)
        except (InputError, KeyError, pygit2.GitError) as error:
            raise InputError(self._missing(f"something that commit {commit} or its parent needs")) from error
        return HistoryCommit(
            id=commit,
            parents=tuple(str(parent) for parent in git_commit.parent_ids),
            message=git_commit.message,
            author=git_commit.author.name,
            committer=git_commit.committer.name,
            authored=git_commit.author.time,
            committed=git_commit.committer.time,
            changes=changes,
            irregular=irregular,
            problem=problem,
            tree=str(git_commit.tree_id),
        )

    def _commit(self, commit: str) -> pygit2.Commit:
        git_commit = self._repository.get(commit)
        if not isinstance(git_commit, pygit2.Commit):
            raise InputError(self._missing(f"commit {commit}"))
        return git_commit

    def _missing(self, what: str) -> str:
        """The words for a clone that lacks objects."""
        return f"{self._where}: {what} is missing; the clone is not whole, clone it again"

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Path -> text of every ordinary text file below `folders` in `commit`."""
        return self._clone.files(commit, folders)

    def brought(self, commit: str) -> int:
        """The number of commits that a merge commit brings, at most BROUGHT_MAX."""
        first, *others = self._commit(commit).parent_ids
        walker = self._repository.walk(first)
        walker.reset()
        for other in others:
            walker.push(other)
        walker.hide(first)
        return sum(1 for _ in itertools.islice(walker, BROUGHT_MAX))

    def notes(self, reference: str) -> NoteHistory:
        """The notes below a reference."""
        branch = self._repository.references.get(reference)
        if branch is None:
            return NoteHistory()
        tip = self._commit(str(branch.target))
        return NoteHistory(self._texts(tip.tree, ""), *self._edits(tip))

    def _texts(self, tree: pygit2.Tree, prefix: str) -> dict[str, str]:
        """Annotated object -> text. Git spreads many notes over folders by the first digits of the objects' ids."""
        texts: dict[str, str] = {}
        for entry in tree:
            name = f"{prefix}{entry.name}"
            if isinstance(entry, pygit2.Tree) and len(name) < HEX_DIGITS:
                texts |= self._texts(entry, name)
            elif isinstance(entry, pygit2.Blob) and len(name) == HEX_DIGITS:
                texts[name] = bytes(entry.data)[:NOTE_BYTES_MAX].decode("utf-8", "replace")
        return texts

    def _edits(self, tip: pygit2.Commit) -> tuple[tuple[NoteEdit, ...], frozenset[str]]:
        """Notes that were changed or removed, oldest first, and all commits of the reference."""
        edits: list[NoteEdit] = []
        commits: set[str] = set()
        commit = tip
        while True:
            commits.add(str(commit.id))
            if len(commits) > COMMITS_MAX or not commit.parent_ids:
                break
            parent = self._commit(str(commit.parent_ids[0]))
            edits += reversed(_edited(commit, parent))
            commit = parent
        return tuple(reversed(edits)), frozenset(commits)


def _edited(commit: pygit2.Commit, parent: pygit2.Commit) -> list[NoteEdit]:
    """The notes that a commit changed or removed; one that only moved to another folder was not."""
    before: dict[str, pygit2.Oid] = {}
    after: dict[str, pygit2.Oid] = {}
    for delta in parent.tree.diff_to_tree(commit.tree).deltas:
        if delta.status_char() in "MD":
            before[delta.old_file.path.replace("/", "")] = delta.old_file.id
        if delta.status_char() in "MA":
            after[delta.new_file.path.replace("/", "")] = delta.new_file.id
    changed = sorted(name for name, blob in before.items() if after.get(name) != blob)
    return [NoteEdit(str(commit.id), name, name not in after) for name in changed]


def fetch_history(url: str, repository: str, username: str, password: str, folder: Path, branch: str = "main") -> str:
    """Bring main and all notes of `<organisation>/<name>` to the bare clone in `folder`, made when it is not there, and
    return main's tip as it was there before, empty when there was none. UnavailableError when the forge does not
    answer."""
    clone = open_clone(folder, url, repository)
    before = clone.references.get(f"refs/heads/{branch}")
    former = str(before.target) if before else ""
    main = f"+refs/heads/{branch}:refs/heads/{branch}"
    try:
        fetch(clone, [main, ALL_NOTES], (username, password), FetchPrune.PRUNE)
    except (pygit2.GitError, PermissionError, OSError) as error:
        raise UnavailableError(f"git {url}/{repository}: fetch: {what_failed(error, url)}") from error
    return former
