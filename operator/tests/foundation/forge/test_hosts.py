"""GitHub and GitLab against servers that speak their APIs' descriptions: the same questions, the same answers.

The services themselves were never asked; what their APIs give is written down here from their documentation."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlparse

import pytest

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.forge.adapters.hosts.github import GitHubForge
from robotkube.foundation.forge.adapters.hosts.gitlab import GitLabForge
from robotkube.foundation.forge.core.reviews import Review
from robotkube.foundation.forge.ports.pull_requests import Comment, PullRequest

HEAD, MERGED = "a" * 40, "b" * 40
Answer = tuple[int, Any]
Call = tuple[str, str, dict[str, str], Any]


class Service(ThreadingHTTPServer):
    """Answers by method and path; remembers what was asked."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.answers: dict[tuple[str, str], Callable[[dict[str, str], Any], Answer]] = {}
        self.calls: list[Call] = []
        self.headers: dict[str, str] = {}
        self.answer_headers: dict[str, str] = {}

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    def give(self, method: str, path: str, body: Any, status: int = 200) -> None:
        self.answers[method, path] = lambda *_: (status, body)

    def asked(self, method: str, path: str) -> tuple[dict[str, str], Any]:
        return next((query, body) for m, p, query, body in reversed(self.calls) if (m, p) == (method, path))


class Handler(BaseHTTPRequestHandler):
    server: Service

    def do_GET(self) -> None:
        url = urlparse(self.path)
        query = {key: values[0] for key, values in parse_qs(url.query).items()}
        text = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        body = json.loads(text) if text else None
        self.server.calls.append((self.command, url.path, query, body))
        self.server.headers = dict(self.headers)
        answer = self.server.answers.get((self.command, url.path), lambda *_: (404, {"message": "Not Found"}))
        status, document = answer(query, body)
        data = json.dumps(document).encode()
        self.send_response(status)
        for name, value in {**self.server.answer_headers, "Content-Length": str(len(data))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    do_POST = do_PUT = do_PATCH = do_GET  # noqa: N815

    def log_message(self, *_: Any) -> None:
        return None


@pytest.fixture
def service() -> Iterator[Service]:
    started = Service()
    thread = threading.Thread(target=started.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield started
    started.shutdown()
    started.server_close()
    thread.join(5)


@pytest.fixture
def github(service: Service) -> Iterator[GitHubForge]:
    forge = GitHubForge("fleet/deployment", "token-1", service.url)
    yield forge
    forge.disconnect()


@pytest.fixture
def gitlab(service: Service) -> Iterator[GitLabForge]:
    forge = GitLabForge("fleet/deployment", "token-1", service.url)
    yield forge
    forge.disconnect()


# -- GitHub -----------------------------------------------------------------------------------------------------------

HUB = "/repos/fleet/deployment"


def hub_pull(number: int, author: str = "manager", state: str = "open", merged_at: str | None = None) -> dict[str, Any]:
    return {
        "number": number,
        "html_url": f"https://github.com/fleet/deployment/pull/{number}",
        "title": "deploy(x): y",
        "state": state,
        "user": {"login": author},
        "head": {
            "sha": HEAD,
            "ref": "robotkube/20261121-100000-abcdef",
            "label": "fleet:robotkube/20261121-100000-abcdef",
        },
        "merged_at": merged_at,
        "merge_commit_sha": MERGED,
    }


def test_github_pull_requests(service: Service, github: GitHubForge) -> None:
    service.give("GET", f"{HUB}/pulls/7", hub_pull(7))
    url = "https://github.com/fleet/deployment/pull/7"
    topic = "20261121-100000-abcdef"
    wanted = PullRequest(7, url, "deploy(x): y", "manager", "open", HEAD, False, "", topic)
    assert github.pull_request(7) == wanted
    assert service.headers["Authorization"] == "Bearer token-1"
    done = hub_pull(6, "somebody", "closed", "2026-11-21T10:00:00Z")
    service.give("GET", f"{HUB}/pulls", [hub_pull(7), done])
    assert [pull.number for pull in github.pull_requests("all", author="manager")] == [7]
    [_, newest] = github.pull_requests("all")
    assert (newest.merged, newest.merge_commit, newest.state) == (True, MERGED, "closed")
    query, _ = service.asked("GET", f"{HUB}/pulls")
    assert query == {"state": "all", "base": "main", "sort": "created", "direction": "desc", "per_page": "50"}


def test_github_opens_a_pull_request_once(service: Service, github: GitHubForge) -> None:
    service.give("POST", f"{HUB}/pulls", hub_pull(8), 201)
    assert github.open_pull_request("robotkube/x", "title", "body") == 8
    _, body = service.asked("POST", f"{HUB}/pulls")
    assert body == {"title": "title", "body": "body", "head": "robotkube/x", "base": "main"}
    service.give("POST", f"{HUB}/pulls", {"message": "Validation Failed: a pull request already exists"}, 422)
    service.give("GET", f"{HUB}/pulls", [hub_pull(8)])
    assert github.open_pull_request("robotkube/x", "title", "body") == 8
    assert service.asked("GET", f"{HUB}/pulls")[0]["head"] == "fleet:robotkube/x"
    service.give("GET", f"{HUB}/pulls", [])
    with pytest.raises(InputError, match=r"422 Validation Failed.*check the token"):
        github.open_pull_request("robotkube/x", "title", "body")


def test_github_comments_and_reviews(service: Service, github: GitHubForge) -> None:
    service.give("GET", f"{HUB}/issues/7/comments", [{"id": 3, "user": {"login": "gate"}, "body": "Accepted"}])
    assert github.comments(7) == [Comment("gate", "Accepted", 3)]
    service.give("POST", f"{HUB}/issues/7/comments", {"id": 4}, 201)
    github.comment(7, "text")
    assert service.asked("POST", f"{HUB}/issues/7/comments")[1] == {"body": "text"}
    service.give("PATCH", f"{HUB}/issues/comments/3", {"id": 3})
    github.edit_comment(3, "other")
    assert service.asked("PATCH", f"{HUB}/issues/comments/3")[1] == {"body": "other"}
    service.give("PATCH", f"{HUB}/pulls/7", hub_pull(7, state="closed"))
    github.close(7)
    assert service.asked("PATCH", f"{HUB}/pulls/7")[1] == {"state": "closed"}
    said = [("ann", "APPROVED", "MEMBER"), ("bob", "COMMENTED", "OWNER"), ("eve", "APPROVED", "NONE")]
    said += [("dan", "CHANGES_REQUESTED", "COLLABORATOR"), ("ann", "DISMISSED", "MEMBER")]
    reviews = [{"user": {"login": a}, "state": s, "commit_id": HEAD, "author_association": r} for a, s, r in said]
    service.give("GET", f"{HUB}/pulls/7/reviews", reviews)
    assert github.reviews(7) == [
        Review("ann", HEAD, True, True),
        Review("eve", HEAD, True, False),
        Review("dan", HEAD, False, True),
    ]


def test_githubs_rate_limit_passes(service: Service, github: GitHubForge) -> None:
    service.give("GET", f"{HUB}/pulls/7", {"message": "API rate limit exceeded"}, 403)
    with pytest.raises(InputError, match="403 API rate limit exceeded; check the token"):
        github.pull_request(7)
    service.answer_headers = {"x-ratelimit-remaining": "0"}
    with pytest.raises(UnavailableError, match="403 API rate limit exceeded"):
        github.pull_request(7)


# -- GitLab -----------------------------------------------------------------------------------------------------------

LAB = "/projects/fleet%2Fdeployment"


def lab_request(number: int, state: str = "opened", merge_commit: str | None = None) -> dict[str, Any]:
    return {
        "iid": number,
        "web_url": f"https://gitlab.com/fleet/deployment/-/merge_requests/{number}",
        "title": "deploy(x): y",
        "state": state,
        "author": {"username": "manager"},
        "sha": HEAD,
        "source_branch": "robotkube/20261121-100000-abcdef",
        "merge_commit_sha": merge_commit,
    }


def test_gitlab_merge_requests(service: Service, gitlab: GitLabForge) -> None:
    service.give("GET", f"{LAB}/merge_requests/7", lab_request(7))
    url = "https://gitlab.com/fleet/deployment/-/merge_requests/7"
    topic = "20261121-100000-abcdef"
    wanted = PullRequest(7, url, "deploy(x): y", "manager", "open", HEAD, False, "", topic)
    assert gitlab.pull_request(7) == wanted
    assert service.headers["PRIVATE-TOKEN"] == "token-1"
    service.give("GET", f"{LAB}/merge_requests", [lab_request(7), lab_request(6, "merged"), lab_request(5, "closed")])
    closed = gitlab.pull_requests("closed", author="manager")
    assert [(pull.number, pull.merged, pull.merge_commit) for pull in closed] == [(6, True, HEAD), (5, False, "")]
    query, _ = service.asked("GET", f"{LAB}/merge_requests")
    assert (query["state"], query["target_branch"], query["author_username"]) == ("all", "main", "manager")
    assert [pull.number for pull in gitlab.pull_requests("open")] == [7]
    assert service.asked("GET", f"{LAB}/merge_requests")[0]["state"] == "opened"


def test_gitlab_opens_a_merge_request_once(service: Service, gitlab: GitLabForge) -> None:
    service.give("POST", f"{LAB}/merge_requests", lab_request(8), 201)
    assert gitlab.open_pull_request("robotkube/x", "title", "body") == 8
    _, body = service.asked("POST", f"{LAB}/merge_requests")
    assert body == {"source_branch": "robotkube/x", "target_branch": "main", "title": "title", "description": "body"}
    service.give("POST", f"{LAB}/merge_requests", {"message": ["Another open merge request already exists"]}, 409)
    service.give("GET", f"{LAB}/merge_requests", [lab_request(8)])
    assert gitlab.open_pull_request("robotkube/x", "title", "body") == 8
    service.give("GET", f"{LAB}/merge_requests", [])
    with pytest.raises(InputError, match=r"409 .*Another open merge request.*check the token"):
        gitlab.open_pull_request("robotkube/x", "title", "body")


def test_gitlab_notes(service: Service, gitlab: GitLabForge) -> None:
    notes = [
        {"id": 3, "author": {"username": "gate"}, "body": "Accepted", "system": False},
        {"id": 4, "author": {"username": "manager"}, "body": "added 1 commit", "system": True},
    ]
    service.give("GET", f"{LAB}/merge_requests/7/notes", notes)
    with pytest.raises(InputError, match="read its comments first"):
        gitlab.edit_comment(3, "other")
    assert gitlab.comments(7) == [Comment("gate", "Accepted", 3)]
    service.give("PUT", f"{LAB}/merge_requests/7/notes/3", {"id": 3})
    gitlab.edit_comment(3, "other")
    assert service.asked("PUT", f"{LAB}/merge_requests/7/notes/3")[1] == {"body": "other"}
    service.give("POST", f"{LAB}/merge_requests/7/notes", {"id": 5}, 201)
    gitlab.comment(7, "text")
    assert service.asked("POST", f"{LAB}/merge_requests/7/notes")[1] == {"body": "text"}
    service.give("PUT", f"{LAB}/merge_requests/7", lab_request(7, "closed"))
    gitlab.close(7)
    assert service.asked("PUT", f"{LAB}/merge_requests/7")[1] == {"state_event": "close"}


def approve(service: Service, resets: bool) -> None:
    service.give("GET", f"{LAB}/approvals", {"reset_approvals_on_push": resets})
    service.give("GET", f"{LAB}/merge_requests/7", lab_request(7))
    users = [{"user": {"id": 1, "username": "ann"}}, {"user": {"id": 2, "username": "eve"}}, {"user": {"id": 3}}]
    service.give("GET", f"{LAB}/merge_requests/7/approvals", {"approved_by": users})
    service.give("GET", f"{LAB}/members/all/1", {"access_level": 30})
    service.give("GET", f"{LAB}/members/all/2", {"access_level": 20})


def test_gitlabs_approvals_count_for_the_head_that_they_were_given_to(service: Service, gitlab: GitLabForge) -> None:
    approve(service, resets=True)
    assert gitlab.reviews(7) == [
        Review("ann", HEAD, True, True),
        Review("eve", HEAD, True, False),
        Review("", HEAD, True, False),
    ]
    approve(service, resets=False)
    assert gitlab.reviews(7) == []


def test_an_approval_does_not_count_for_what_was_pushed_meanwhile(service: Service, gitlab: GitLabForge) -> None:
    approve(service, resets=True)
    heads = iter([HEAD, MERGED])
    service.answers["GET", f"{LAB}/merge_requests/7"] = lambda *_: (200, {**lab_request(7), "sha": next(heads)})
    assert gitlab.reviews(7) == []


# -- both -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("status", [429, 500, 503])
def test_a_service_in_trouble_is_asked_again_later(service: Service, status: int) -> None:
    for forge, path in (
        (GitHubForge("fleet/deployment", "t", service.url), f"{HUB}/pulls/7"),
        (GitLabForge("fleet/deployment", "t", service.url), f"{LAB}/merge_requests/7"),
    ):
        service.give("GET", path, {"message": "busy"}, status)
        with pytest.raises(UnavailableError, match=f"{status} busy"):
            forge.pull_request(7)
        forge.disconnect()


def test_nobody_there_is_unavailable() -> None:
    for forge in (
        GitHubForge("fleet/deployment", "t", "http://127.0.0.1:9"),
        GitLabForge("fleet/deployment", "t", "http://127.0.0.1:9"),
    ):
        with pytest.raises(UnavailableError, match=r"127\.0\.0\.1:9"):
            forge.pull_requests()
        forge.disconnect()


def test_a_refused_token_says_what_to_look_at(service: Service, github: GitHubForge, gitlab: GitLabForge) -> None:
    service.give("GET", f"{HUB}/pulls/7", {"message": "Bad credentials"}, 401)
    with pytest.raises(InputError, match="401 Bad credentials; check the token and its permissions contents"):
        github.pull_request(7)
    service.give("GET", f"{LAB}/merge_requests/7", {"message": "401 Unauthorized"}, 401)
    with pytest.raises(InputError, match="401 Unauthorized; check the token, its scope api"):
        gitlab.pull_request(7)
