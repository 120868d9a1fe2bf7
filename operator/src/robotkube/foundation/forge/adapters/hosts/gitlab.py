"""Merge requests of one project on GitLab (gitlab.com or self-managed), over its REST API v4, as pull requests.

Proposals are branches, opened as merge requests by `open_pull_request`. GitLab marks a merge request merged by itself
when its head reaches the target branch. An approval names no commit there: it counts only in projects that take
approvals back on every push. Written from GitLab's API description; not tried against the service."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from robotkube.errors import InputError
from robotkube.foundation.forge.adapters.hosts.connection import ForgeConnection
from robotkube.foundation.forge.core.reviews import Review
from robotkube.foundation.forge.ports.pull_requests import Comment, PullRequest
from robotkube.writes import writes

API = "https://gitlab.com/api/v4"
MERGE_REQUESTS_MAX = 50
NOTES_MAX = 100
NOTES_KEPT_MAX = 1000
DEVELOPER = 30  # access level from which a member may push
STATES = {"open": "opened", "closed": "all", "all": "all"}  # `closed` leaves merged ones out there, not here


class GitLabForge:
    """The port Forge for the project `<group>/<name>` below `api` (no slash at the end), with an access token."""

    def __init__(self, repository: str, token: str, api: str = API, branch: str = "main") -> None:
        self._branch = branch
        self._notes: OrderedDict[int, int] = OrderedDict()
        self._connection = ForgeConnection(
            f"{api}/projects/{quote(repository, safe='')}",
            f"forge {api} project {repository}",
            "check the token, its scope api and its role in the project (Developer at least)",
            headers={"PRIVATE-TOKEN": token},
        )

    def disconnect(self) -> None:
        """Close the connections."""
        self._connection.disconnect()

    def pull_request(self, number: int) -> PullRequest:
        """One merge request by its number in the project."""
        return read_merge_request(self._connection.call("GET", f"/merge_requests/{number}"))

    def pull_requests(self, state: str = "open", author: str = "") -> Sequence[PullRequest]:
        """Merge requests against the branch, newest first, at most MERGE_REQUESTS_MAX; `author` narrows."""
        query: dict[str, str | int] = {
            "state": STATES[state],
            "target_branch": self._branch,
            "order_by": "created_at",
            "sort": "desc",
            "per_page": MERGE_REQUESTS_MAX,
            **({"author_username": author} if author else {}),
        }
        pulls = [read_merge_request(item) for item in self._connection.call("GET", "/merge_requests", params=query)]
        return [pull for pull in pulls if state in ("all", pull.state)]

    @writes("forge")
    def open_pull_request(self, branch: str, title: str, body: str) -> int:
        """The number of the open merge request of `branch`; it is opened when there is none."""
        request = {"source_branch": branch, "target_branch": self._branch, "title": title, "description": body}
        try:
            return int(self._connection.call("POST", "/merge_requests", json=request)["iid"])
        except InputError:
            query = {"state": "opened", "source_branch": branch, "target_branch": self._branch}
            present = self._connection.call("GET", "/merge_requests", params=query)
            if not present:
                raise
            return int(present[0]["iid"])

    def comments(self, number: int) -> Sequence[Comment]:
        """Notes of people and accounts on a merge request, oldest first, at most NOTES_MAX; not those of GitLab."""
        query: dict[str, str | int] = {"sort": "asc", "order_by": "created_at", "per_page": NOTES_MAX}
        documents = self._connection.call("GET", f"/merge_requests/{number}/notes", params=query)
        notes = [item for item in documents if not item.get("system")]
        for item in notes:
            self._remember(int(item["id"]), number)
        return [Comment(_username(item), str(item.get("body") or ""), int(item["id"])) for item in notes]

    def _remember(self, identifier: int, number: int) -> None:
        """A note can be edited only by naming its merge request as well."""
        self._notes[identifier] = number
        while len(self._notes) > NOTES_KEPT_MAX:
            self._notes.popitem(last=False)

    @writes("forge")
    def comment(self, number: int, text: str) -> None:
        """Add a note (Markdown)."""
        self._connection.call("POST", f"/merge_requests/{number}/notes", json={"body": text})

    def reviews(self, number: int) -> Sequence[Review]:
        """Approvals of the present head by those who may push; none in a project where a push leaves them standing."""
        settings = self._connection.call("GET", "/approvals")
        if not settings.get("reset_approvals_on_push"):
            return []
        head = self.pull_request(number).head
        approvals = self._connection.call("GET", f"/merge_requests/{number}/approvals")
        if self.pull_request(number).head != head:
            return []  # pushed between both requests; the next round reads what stands
        users = [item.get("user") or {} for item in approvals.get("approved_by") or []]
        return [Review(str(user.get("username", "")), head, True, self._may_push(user.get("id"))) for user in users]

    def _may_push(self, user: object) -> bool:
        try:
            member = self._connection.call("GET", f"/members/all/{user}")
        except InputError:
            return False
        return int(member.get("access_level", 0)) >= DEVELOPER

    @writes("forge")
    def edit_comment(self, identifier: int, text: str) -> None:
        """Give a note of this account another text; `comments` must have shown it."""
        if identifier not in self._notes:
            raise InputError(f"note {identifier} was not read from a merge request; read its comments first")
        path = f"/merge_requests/{self._notes[identifier]}/notes/{identifier}"
        self._connection.call("PUT", path, json={"body": text})

    @writes("forge")
    def close(self, number: int) -> None:
        """Close a merge request without merging it."""
        self._connection.call("PUT", f"/merge_requests/{number}", json={"state_event": "close"})


def read_merge_request(document: Mapping[str, Any]) -> PullRequest:
    """A merge request of GitLab's API as the port's value."""
    merged = document.get("state") == "merged"
    return PullRequest(
        number=int(document["iid"]),
        url=str(document.get("web_url", "")),
        title=str(document.get("title", "")),
        author=_username(document),
        state="open" if document.get("state") in ("opened", "locked") else "closed",
        head=str(document.get("sha") or ""),
        merged=merged,
        merge_commit=str(document.get("merge_commit_sha") or document.get("sha") or "") if merged else "",
        topic=str(document.get("source_branch") or "").rpartition("/")[2],
    )


def _username(document: Mapping[str, Any]) -> str:
    return str((document.get("author") or {}).get("username", ""))
