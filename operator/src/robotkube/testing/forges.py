"""A forge with its repositories in memory: ports DeploymentRepository, Proposals, Catalogue and Forge, and a gate whose
decisions a test makes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.core.reviews import Review
from robotkube.foundation.forge.ports.pull_requests import Comment, PullRequest
from robotkube.foundation.forge.ports.repositories import Commit


@dataclass
class MemoryRepository:
    """Commits on main; `away` makes every call fail as if the forge did not answer."""

    commits: dict[str, Commit] = field(default_factory=dict)
    trees: dict[str, dict[str, str]] = field(default_factory=dict)
    tip: str = ""
    away: bool = False
    fetches: int = 0
    heads: dict[int, str] = field(default_factory=dict)

    def fetch(self) -> str:
        """Main's tip."""
        self._reach()
        self.fetches += 1
        return self.tip

    def moved_to(self, commit: str) -> None:
        """Check that main is at this commit; memory needs no notice of it."""
        assert commit == self.tip, f"main is at {self.tip!r}, not at {commit}"

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Files below the folders."""
        return {p: t for p, t in self.trees[commit].items() if any(p.startswith(f"{folder}/") for folder in folders)}

    def irregular(self, commit: str, folders: Sequence[str]) -> Sequence[str]:
        """No files: memory holds texts only."""
        return ()

    def headers(self, since: str, commits_max: int) -> Iterator[tuple[str, str]]:
        """Main's newest commits, newest first."""
        for commit in reversed(self.log(since or None, commits_max)):
            yield commit.id, commit.message

    def proposal(self, number: int) -> Commit:
        """The head of a pull request."""
        self._reach()
        return self.commits[self.heads[number]]

    def contains(self, commit: str) -> bool:
        """Return whether a commit is on main."""
        return any(known.id == commit for known in self.log(None, len(self.commits)))

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """Main's newest commits, oldest first."""
        commits: list[Commit] = []
        at = self.tip
        while at and at != since and len(commits) < commits_max:
            commits.append(self.commits[at])
            at = self.commits[at].parents[0] if self.commits[at].parents else ""
        return commits[::-1]

    def touching(self, since: str | None, commits_max: int, path: str, words: Sequence[str]) -> Sequence[Commit]:
        """Main's newest commits that change the path or hold a word."""
        commits = self.log(since, commits_max)
        return [c for c in commits if path in c.changes or any(word in c.message for word in words)]

    def commit(
        self, parent: str, changes: Mapping[str, str | None], message: str, merged: str = "", author: str = "manager"
    ) -> str:
        """Make a commit that is not on main; `merged` is its second parent."""
        if parent and parent not in self.commits:
            raise InputError(f"commit {parent!r} is not here")
        tree = {p: t for p, t in {**self.trees.get(parent, {}), **changes}.items() if t is not None}
        identifier = hashlib.sha1(repr((parent, merged, sorted(tree.items()), message)).encode()).hexdigest()  # noqa: S324
        parents = tuple(identity for identity in (parent, merged) if identity)
        self.commits[identifier] = Commit(identifier, parents, message, author, dict(changes))
        self.trees[identifier] = tree
        return identifier

    def push(self, changes: Mapping[str, str | None], message: str = "by hand") -> str:
        """Make a commit straight onto main, as a person's merge does."""
        self.tip = self.commit(self.tip, changes, message)
        return self.tip

    def _reach(self) -> None:
        if self.away:
            raise UnavailableError("the forge does not answer")


class MemoryForge:
    """Pull requests of one repository; `decide` sees every new one and may call `merge`, `refuse` or nothing."""

    def __init__(self, repository: MemoryRepository) -> None:
        self.repository = repository
        self.pulls: dict[int, PullRequest] = {}
        self.bodies: dict[int, str] = {}
        self.said: dict[int, list[Comment]] = {}
        self.reviewed: dict[int, list[Review]] = {}
        self.decide: Callable[[PullRequest], None] = self.merge
        self.gives_numbers = True
        self._comments = 0

    def commit(
        self, parent: str, changes: Mapping[str, str | None], message: str, merged: str = "", author: str = "manager"
    ) -> str:
        """Make a commit that is not on main."""
        return self.repository.commit(parent, changes, message, merged, author)

    def propose(self, commit: str, topic: str, title: str, body: str) -> int | None:
        """Open a pull request and let the gate check it."""
        self.repository._reach()
        number = len(self.pulls) + 1
        pull = PullRequest(number, f"http://forge/pulls/{number}", title, "manager", "open", commit, False, topic=topic)
        self.pulls[number] = pull
        self.bodies[number] = body
        self.said[number] = []
        self.repository.heads[number] = commit
        self.decide(pull)
        return number if self.gives_numbers else None

    def pull_request(self, number: int) -> PullRequest:
        """One pull request."""
        self.repository._reach()
        return self.pulls[number]

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """Pull requests, newest first."""
        self.repository._reach()
        pulls = [p for p in reversed(self.pulls.values()) if state in ("all", p.state) and author in ("", p.author)]
        return pulls[:50]

    def comments(self, number: int) -> Sequence[Comment]:
        """The comments of a pull request."""
        return self.said[number]

    def comment(self, number: int, text: str) -> None:
        """Add a comment."""
        self._comments += 1
        self.said[number].append(Comment("gate", text, self._comments))

    def edit_comment(self, identifier: int, text: str) -> None:
        """Change a comment's text."""
        for comments in self.said.values():
            comments[:] = [replace(c, text=text) if c.id == identifier else c for c in comments]

    def reviews(self, number: int) -> Sequence[Review]:
        """The reviews of a pull request: who approved, and who is against it."""
        return self.reviewed.get(number, [])

    def close(self, number: int) -> None:
        """Close without merging."""
        self.pulls[number] = replace(self.pulls[number], state="closed")

    def merge(self, pull: PullRequest) -> None:
        """Move main to the pull request's commit when that is possible, else close it as the gate does."""
        if self.repository.commits[pull.head].parents != (self.repository.tip,):
            self.refuse(pull, "Closed, main moved: build it again.")
            return
        self.repository.tip = pull.head
        self.pulls[pull.number] = replace(pull, state="closed", merged=True, merge_commit=pull.head)

    def refuse(self, pull: PullRequest, text: str) -> None:
        """Comment and close."""
        self.comment(pull.number, text)
        self.close(pull.number)

    def leave(self, pull: PullRequest) -> None:
        """Leave the pull request as it is: decide nothing."""
