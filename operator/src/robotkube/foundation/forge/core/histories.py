"""The history of a branch and of its notes as values, for those who read all of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class HistoryCommit:
    """A commit of a branch, with who made it and when (seconds since 1970, by the clocks of author and committer).

    `changes` is the difference to the first parent: path -> new text, None = removed; a path whose new content is no
    ordinary text file stands in `irregular`. `problem`: why its changes could not be read, empty when they were. `tree`
    is the id of all its files."""

    id: str
    parents: tuple[str, ...]
    message: str
    author: str
    committer: str
    authored: int
    committed: int
    changes: Mapping[str, str | None] = field(default_factory=dict)
    irregular: tuple[str, ...] = ()
    problem: str = ""
    tree: str = ""

    @property
    def subject(self) -> str:
        """The first line of its message."""
        return self.message.partition("\n")[0]

    @property
    def paths(self) -> tuple[str, ...]:
        """Every path that it changes."""
        return tuple(sorted({*self.changes, *self.irregular}))


@dataclass(frozen=True)
class NoteEdit:
    """A note that was changed or removed after it had been written: in the notes' commit `by`, the note of the object
    `annotated`."""

    by: str
    annotated: str
    removed: bool


@dataclass(frozen=True)
class NoteHistory:
    """The notes below one reference: `texts` object -> text, as they stand; `edits` of older ones; `commits` are all
    commits of the reference, so that a former tip can be looked for."""

    texts: Mapping[str, str] = field(default_factory=dict)
    edits: tuple[NoteEdit, ...] = ()
    commits: frozenset[str] = frozenset()
