"""The forge with its pull requests, and Argo CD as asked by manager and gate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from robotkube.foundation.forge.core.reviews import Review


@dataclass(frozen=True)
class PullRequest:
    """A pull request of the deployment repository. `state` is open or closed; `head` the proposed commit;
    `merge_commit` main's commit when merged; `topic` the plan's id for proposals of the manager."""

    number: int
    url: str
    title: str
    author: str
    state: str
    head: str
    merged: bool
    merge_commit: str = ""
    topic: str = ""


@dataclass(frozen=True)
class Comment:
    """A comment on a pull request; `id` is the forge's."""

    author: str
    text: str
    id: int = 0


class Forge(Protocol):
    """Pull requests of the deployment repository; all methods raise UnavailableError when the forge is away."""

    def pull_request(self, number: int) -> PullRequest:
        """One pull request by its number."""
        ...

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """Pull requests against main, newest first, at most 50; `state` is open, closed or all; `author` narrows."""
        ...

    def comments(self, number: int) -> Sequence[Comment]:
        """Comments of a pull request, oldest first."""
        ...

    def comment(self, number: int, text: str) -> None:
        """Add a comment (Markdown)."""
        ...

    def reviews(self, number: int) -> Sequence[Review]:
        """Approvals and requests for changes of a pull request that still stand, oldest first, at most 50."""
        ...

    def edit_comment(self, identifier: int, text: str) -> None:
        """Give a comment of this account another text."""
        ...

    def close(self, number: int) -> None:
        """Close a pull request without merging it."""
        ...


class PushHook(Protocol):
    """The notification of Argo CD that main moved; best effort and bounded."""

    def hook(self, before: str, after: str) -> bool:
        """Send the signed, GitHub-shaped push event of main to the ApplicationSet controller; whether it was
        accepted."""
        ...
