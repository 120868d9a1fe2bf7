"""Pull requests of one repository on GitHub (github.com or an Enterprise Server), over its REST API.

GitHub has no pushes for review: proposals are branches, opened as pull requests by `open_pull_request`. It marks a
pull request merged by itself when its head reaches the base branch. Written from GitHub's API description; not tried
against the service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.forge.adapters.hosts.connection import ForgeConnection
from robotkube.foundation.forge.core.reviews import Review
from robotkube.foundation.forge.ports.pull_requests import Comment, PullRequest
from robotkube.writes import writes

API = "https://api.github.com"
PULL_REQUESTS_MAX = 50
COMMENTS_MAX = 100
REVIEWS_MAX = 50
WRITERS = frozenset({"OWNER", "MEMBER", "COLLABORATOR"})
REVIEW_STATES = {"APPROVED": True, "CHANGES_REQUESTED": False}


class GitHubForge:
    """The port Forge for `<owner>/<name>` below `api` (no slash at the end), with an access token."""

    def __init__(self, repository: str, token: str, api: str = API, branch: str = "main") -> None:
        self._owner = repository.partition("/")[0]
        self._branch = branch
        self._connection = ForgeConnection(
            f"{api}/repos/{repository}",
            f"forge {api} repository {repository}",
            "check the token and its permissions contents, pull requests and issues",
            headers={
                "Authorization": f"Bearer {token}",
                "Accept": "application/vnd.github+json",
                "X-GitHub-Api-Version": "2022-11-28",
            },
        )

    def disconnect(self) -> None:
        """Close the connections."""
        self._connection.disconnect()

    def pull_request(self, number: int) -> PullRequest:
        """One pull request by its number."""
        return read_pull_request(self._connection.call("GET", f"/pulls/{number}"))

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """Pull requests against the branch, newest first, at most PULL_REQUESTS_MAX, of which `author` keeps its own:
        GitHub does not narrow by author."""
        query = {"state": state, "base": self._branch, "sort": "created", "direction": "desc"}
        documents = self._connection.call("GET", "/pulls", params={**query, "per_page": PULL_REQUESTS_MAX})
        pulls = [read_pull_request(item) for item in documents]
        return [pull for pull in pulls if author in ("", pull.author)]

    @writes("forge")
    def open_pull_request(self, branch: str, title: str, body: str) -> int:
        """The number of the open pull request of `branch`; it is opened when there is none."""
        request = {"title": title, "body": body, "head": branch, "base": self._branch}
        try:
            return int(self._connection.call("POST", "/pulls", json=request)["number"])
        except InputError:
            query = {"state": "open", "head": f"{self._owner}:{branch}", "base": self._branch}
            present = self._connection.call("GET", "/pulls", params=query)
            if not present:
                raise
            return int(present[0]["number"])

    def comments(self, number: int) -> Sequence[Comment]:
        """Comments of a pull request, oldest first, at most COMMENTS_MAX."""
        documents = self._connection.call("GET", f"/issues/{number}/comments", params={"per_page": COMMENTS_MAX})
        return [Comment(_login(item), str(item.get("body") or ""), int(item["id"])) for item in documents]

    @writes("forge")
    def comment(self, number: int, text: str) -> None:
        """Add a comment (Markdown)."""
        self._connection.call("POST", f"/issues/{number}/comments", json={"body": text})

    def reviews(self, number: int) -> Sequence[Review]:
        """Approvals and requests for changes that were not dismissed, oldest first, at most REVIEWS_MAX."""
        documents = self._connection.call("GET", f"/pulls/{number}/reviews", params={"per_page": REVIEWS_MAX})
        return [
            Review(
                author=_login(item),
                commit=str(item.get("commit_id") or ""),
                approved=REVIEW_STATES[item["state"]],
                official=item.get("author_association") in WRITERS,
            )
            for item in documents
            if item.get("state") in REVIEW_STATES
        ]

    @writes("forge")
    def edit_comment(self, identifier: int, text: str) -> None:
        """Give a comment of this account another text."""
        self._connection.call("PATCH", f"/issues/comments/{identifier}", json={"body": text})

    @writes("forge")
    def close(self, number: int) -> None:
        """Close a pull request without merging it."""
        self._connection.call("PATCH", f"/pulls/{number}", json={"state": "closed"})


def read_pull_request(document: Mapping[str, Any]) -> PullRequest:
    """A pull request of GitHub's API as the port's value: only `merged_at` stands in lists and in single answers."""
    head = document.get("head") or {}
    merged = bool(document.get("merged_at"))
    return PullRequest(
        number=int(document["number"]),
        url=str(document.get("html_url", "")),
        title=str(document.get("title", "")),
        author=_login(document),
        state=str(document.get("state", "")),
        head=str(head.get("sha", "")),
        merged=merged,
        merge_commit=str(document.get("merge_commit_sha") or "") if merged else "",
        topic=str(head.get("ref") or "").rpartition("/")[2],
    )


def _login(document: Mapping[str, Any]) -> str:
    return str((document.get("user") or {}).get("login", ""))
