"""The ports: what services need of the world, one marked section per part; adapters and `testing` implement them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.domain.observation import ApplicationState, PodState

# ---------------------------------------------------------------------------------------------------------------------
# Git: deployment repository and catalogue repository
# ---------------------------------------------------------------------------------------------------------------------


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


class RepositoryFiles(Protocol):
    """A branch `main` that can be read."""

    def fetch(self) -> str:
        """Bring main's tip here and return its commit id (40 hex). UnavailableError when the forge does not answer."""
        ...

    def files(self, commit: str, folders: Sequence[str]) -> Mapping[str, str]:
        """Path -> text of every file below `folders` in `commit`."""
        ...


class Catalogue(RepositoryFiles, Protocol):
    """The catalogue repository: applications/, charts/, policies/."""


class DeploymentRepository(RepositoryFiles, Protocol):
    """The deployment repository as the manager sees it: it reads and proposes, it cannot write main."""

    def commit(self, parent: str, changes: Mapping[str, str | None], message: str) -> str:
        """Make a commit on `parent` (path -> text, None removes) in memory and return its id."""
        ...

    def propose(self, commit: str, topic: str, title: str, body: str) -> int | None:
        """Open a pull request for exactly that commit; its number when the forge's answer names it, else None.

        UnavailableError when the forge does not answer, RefusalError(ProposalRefused) when it says no."""
        ...


class MainBranch(RepositoryFiles, Protocol):
    """The deployment repository as the gate sees it."""

    def proposal(self, number: int) -> Commit:
        """The head commit of a pull request, fetched."""
        ...

    def push_main(self, commit: str) -> bool:
        """Move main to `commit` (its parent must be main's tip); False when main has moved meanwhile."""
        ...

    def log(self, since: str | None, commits_max: int) -> Sequence[Commit]:
        """Commits of main after `since` (exclusive; None = from the first), oldest first."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Forge
# ---------------------------------------------------------------------------------------------------------------------


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
    """A comment on a pull request."""

    author: str
    text: str


class Forge(Protocol):
    """Pull requests of the deployment repository; all methods raise UnavailableError when the forge is away."""

    def pull_request(self, number: int) -> PullRequest:
        """One pull request by its number."""
        ...

    def pull_requests(self, state: str = "open") -> Sequence[PullRequest]:
        """Pull requests against main, newest first, at most 50; `state` is open, closed or all."""
        ...

    def comments(self, number: int) -> Sequence[Comment]:
        """Comments of a pull request, oldest first."""
        ...

    def comment(self, number: int, text: str) -> None:
        """Add a comment (Markdown)."""
        ...

    def close(self, number: int) -> None:
        """Close a pull request without merging it."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Argo CD
# ---------------------------------------------------------------------------------------------------------------------


class ArgoCD(Protocol):
    """Asking Argo CD to look again; both calls are best effort and bounded, and say whether they were heard."""

    def hook(self, before: str, after: str) -> bool:
        """Send the signed, GitHub-shaped push event of main to the ApplicationSet controller."""
        ...

    def refresh(self, application: str) -> bool:
        """GET the Application with refresh=normal."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# Cluster: what the manager reads of Kubernetes, and the tasks
# ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class NodeState:
    """A Node that belongs to an agent (label robotkube.io/agent)."""

    name: str
    agent: str
    role: str
    capabilities: frozenset[str]
    ready: bool
    cordoned: bool = False


class TaskStore(Protocol):
    """TaskDescriptions of all agents' namespaces."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """The objects as Kubernetes holds them now (those being deleted included)."""
        ...

    def patch_status(self, namespace: str, name: str, status: Mapping[str, Any]) -> bool:
        """Replace the given fields of the status; False when the task is gone."""
        ...


class Cluster(Protocol):
    """What the manager sees of the cluster; values are snapshots kept up to date by watches."""

    def nodes(self) -> Sequence[NodeState]:
        """Nodes of agents."""
        ...

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        ...

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release, named `<namespace>/<release>` (label app.kubernetes.io/instance)."""
        ...
