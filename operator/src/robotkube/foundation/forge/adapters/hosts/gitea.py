"""Pull requests of one repository in Gitea, over its API: one connection kept open, errors translated and chained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.foundation.forge.adapters.hosts.connection import ForgeConnection
from robotkube.foundation.forge.core.reviews import Review
from robotkube.foundation.forge.ports.pull_requests import Comment, PullRequest
from robotkube.writes import writes

PULL_REQUESTS_MAX = 50
COMMENTS_MAX = 100
REVIEWS_MAX = 50


class GiteaForge:
    """The port Forge for `<organisation>/<name>` at `url` (no slash at the end), as account `username`.

    UnavailableError: no answer, or an answer 5xx or 429. InputError: any other refusal, which needs somebody to act.
    """

    def __init__(self, url: str, repository: str, username: str, password: str, branch: str = "main") -> None:
        self._branch = branch
        self._connection = ForgeConnection(
            f"{url}/api/v1/repos/{repository}",
            f"forge {url} repository {repository} as {username}",
            "check the account's password and its access to the repository (the bootstrap Job sets both)",
            account=(username, password),
        )

    def disconnect(self) -> None:
        """Close the connections."""
        self._connection.disconnect()

    def pull_request(self, number: int) -> PullRequest:
        """One pull request by its number."""
        return read_pull_request(self._connection.call("GET", f"/pulls/{number}"))

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """Pull requests against the branch, newest first, at most PULL_REQUESTS_MAX; `author` narrows."""
        query: dict[str, str | int] = {"state": state, "base_branch": self._branch, "limit": PULL_REQUESTS_MAX}
        if author:
            query["poster"] = author
        return [read_pull_request(document) for document in self._connection.call("GET", "/pulls", params=query)]

    def comments(self, number: int) -> Sequence[Comment]:
        """Comments of a pull request, oldest first, at most COMMENTS_MAX."""
        documents = self._connection.call("GET", f"/issues/{number}/comments", params={"limit": COMMENTS_MAX})
        return [
            Comment((item.get("user") or {}).get("login", ""), item.get("body", ""), int(item["id"]))
            for item in documents
        ]

    @writes("forge")
    def comment(self, number: int, text: str) -> None:
        """Add a comment (Markdown)."""
        self._connection.call("POST", f"/issues/{number}/comments", json={"body": text})

    def reviews(self, number: int) -> Sequence[Review]:
        """Approvals and requests for changes that were not dismissed, oldest first, at most REVIEWS_MAX."""
        documents = self._connection.call("GET", f"/pulls/{number}/reviews", params={"limit": REVIEWS_MAX})
        return [
            Review(
                author=str((item.get("user") or {}).get("login", "")),
                commit=str(item.get("commit_id", "")),
                approved=item["state"] == "APPROVED",
                official=item.get("official") is True,
            )
            for item in documents
            if item.get("state") in ("APPROVED", "REQUEST_CHANGES") and not item.get("dismissed")
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
    """A pull request of Gitea's API as the port's value."""
    head = document.get("head") or {}
    return PullRequest(
        number=int(document["number"]),
        url=str(document.get("html_url", "")),
        title=str(document.get("title", "")),
        author=str((document.get("user") or {}).get("login", "")),
        state=str(document.get("state", "")),
        head=str(head.get("sha", "")),
        merged=bool(document.get("merged")),
        merge_commit=str(document.get("merge_commit_sha") or "") if document.get("merged") else "",
        topic=str(head.get("label") or head.get("ref") or "").rpartition("/")[2],
    )
