"""The Git repositories: deployment repository and catalogue."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from robotkube.foundation.forge.core.commit_objects import CommitObjects


@dataclass(frozen=True)
class Commit:
    """A commit as its reader sees it. `changes` is the difference to the first parent: path -> new text, None =
    removed; a path whose new content is not a text file of ordinary mode stands in `irregular`."""

    id: str
    parents: tuple[str, ...]
    message: str
    author: str
    changes: Mapping[str, str | None]
    irregular: tuple[str, ...] = ()


@dataclass(frozen=True)
class CommitShape:
    """What a commit stands on and what it holds, as signatures about it name them: ids of its parents and its tree."""

    parents: tuple[str, ...]
    tree: str


class RepositoryFiles(Protocol):
    """A branch `main` that can be read."""

    def fetch(self) -> str:
        """Bring main's tip here and return its commit id (40 hex). UnavailableError when the forge does not answer."""
        ...

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Path -> text of every file below `folders` in `commit`."""
        ...


class MainHistory(RepositoryFiles, Protocol):
    """Main with its history."""

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        """Paths of the files below `folders` in `commit` that `files` leaves out: no ordinary text files."""
        ...

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        """Id and message of main's commits after `since` (exclusive; empty = from the first), newest first."""
        ...


class CatalogueRepository(RepositoryFiles, Protocol):
    """The catalogue repository: applications/, charts/, policies/."""


class DeploymentRepository(MainHistory, Protocol):
    """The deployment repository's main as the manager reads it."""

    def moved_to(self, commit: str) -> None:
        """Note that main stands at `commit`, which is here: as if it had been fetched."""
        ...

    def proposal(self, number: int) -> Commit:
        """The head commit of a pull request, fetched together with main."""
        ...

    def contains(self, commit: str) -> bool:
        """Return whether `commit`, which is here, is main's tip or one of its ancestors."""
        ...

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """The newest `commits_max` commits of main after `since` (exclusive; None = from the first), oldest first."""
        ...

    def touching(self, since: str | None, commits_max: int, path: str, words: Sequence[str]) -> Sequence[Commit]:
        """Those of main's newest `commits_max` commits after `since` (exclusive; None = from the first) that change
        `path` or whose message holds one of `words`, oldest first."""
        ...


class Commits(Protocol):
    """Commits of one's own, made in memory."""

    def commit(
        self, parent: str, changes: Mapping[str, str | None], message: str, merged: str = "", author: str = ""
    ) -> str:
        """Make a commit on `parent`, which was fetched (path -> text, None removes), in memory; its id. `merged`: a
        second parent, which gives nothing but its place in history; `author`: whose change it is when not one's own."""
        ...


class Proposals(Commits, Protocol):
    """What the manager and publishers may write: commits proposed as pull requests; never main."""

    def propose(self, commit: str, topic: str, title: str, body: str) -> int | None:
        """Open a pull request for exactly that commit; its number when the forge's answer names it, else None.

        UnavailableError when the forge does not answer, RefusalError(ProposalRefused) when it refuses."""
        ...


class Notes(Protocol):
    """Git notes about commits of main."""

    def missing(self, commits: Sequence[str]) -> Sequence[str]:
        """Those of the commits that have no note yet."""
        ...

    def tip(self, reference: str) -> str:
        """The tip of a reference with notes, as it was when `missing` was asked last; empty when there is none."""
        ...

    def add(self, texts: Mapping[str, str]) -> None:
        """Give commits their notes (commit -> text), together."""
        ...


class NoteTexts(Protocol):
    """Git notes as they are read."""

    def texts(self, commits: Sequence[str]) -> Mapping[str, str]:
        """The notes that these commits have at the forge, or had when this was asked before, without the newline at
        their end; who has none is left out. UnavailableError when the forge does not answer."""
        ...


class MainBranch(MainHistory, Protocol):
    """The deployment repository as the gate sees it."""

    @property
    def tip(self) -> str:
        """Main's tip as last fetched or pushed; empty before the first fetch."""
        ...

    def proposal(self, number: int) -> Commit:
        """The head commit of a pull request, fetched together with main."""
        ...

    def receive(self, objects: CommitObjects) -> Commit | None:
        """Store commit objects; their commit, when it stands on main's tip as it is known here and everything that it
        brings is here now; None: it has to be fetched."""
        ...

    def contains(self, commit: str) -> bool:
        """Return whether `commit` is main's tip or one of its ancestors."""
        ...

    def changes_since_branch(self, commit: str) -> Commit:
        """`commit`, which is here, with everything it changes since it left main: as if that were its only parent."""
        ...

    def overlaps(self, change: Commit) -> Sequence[str]:
        """Paths of `change`, as `changes_since_branch` gives it, that main has changed otherwise since; none: both can
        be joined file by file."""
        ...

    def shape(self, commit: str) -> CommitShape:
        """Parents and tree of a commit that is here."""
        ...

    def still_as_in(self, commit: str) -> Sequence[str]:
        """Paths that `commit`, one of main's, changed and that main's tip has as it brought them."""
        ...

    def push_main(self, commit: str) -> bool:
        """Move main to `commit` (its parent must be main's tip); False when main has moved meanwhile."""
        ...

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """Commits of main after `since` (exclusive; None = from the first), oldest first."""
        ...
