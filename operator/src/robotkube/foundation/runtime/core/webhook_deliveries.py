"""Deliveries of webhooks: a forge's signed request, read from its headers and body.

Signed with HMAC-SHA256 of the body (X-Gitea-Signature, X-Hub-Signature-256), or with the secret itself in
X-Gitlab-Token. GitLab's events are translated into the words of the other two.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.foundation.documents.core.json_codec import read_json

GITLAB_ACTIONS = {
    "open": "opened",
    "reopen": "reopened",
    "update": "synchronized",
    "close": "closed",
    "merge": "closed",
}
FORMS: Mapping[str, type] = {
    "action": str,
    "after": str,
    "ref": str,
    "repository": dict,
    "repository.full_name": str,
    "pull_request": dict,
    "pull_request.number": int,
    "pull_request.merged": bool,
    "pull_request.user": dict,
    "pull_request.user.login": str,
    "pull_request.head": dict,
    "pull_request.head.sha": str,
    "issue": dict,
    "issue.number": int,
}
"""What receivers read of a payload, and its form; each may be missing or null."""
_FORM_WORDS: Mapping[type, str] = {str: "text", dict: "an object", int: "a whole number", bool: "true or false"}


class RequestError(Exception):
    """A request that is refused with the HTTP status `status`; its text says why."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True)
class WebhookDelivery:
    """A signed delivery: the forge's event name (push, pull_request, pull_request_sync, ...) and its decoded body, in
    which everything that FORMS names has that form."""

    event: str
    payload: Mapping[str, Any]

    @property
    def repository(self) -> str:
        """`<organisation>/<name>`, empty when the payload names none."""
        return str((self.payload.get("repository") or {}).get("full_name") or "")

    def moved_to(self, repository: str, branch: str) -> str | None:
        """The branch's new tip when this says that it moved (empty when it does not name the tip); else None."""
        if (self.event, self.repository, self.payload.get("ref")) != ("push", repository, f"refs/heads/{branch}"):
            return None
        tip = self.payload.get("after")
        return tip if isinstance(tip, str) else ""


def sign(body: bytes, secret: bytes) -> str:
    """Hexadecimal HMAC-SHA256 of `body`, as the forge and GitHub compute it."""
    return hmac.new(secret, body, hashlib.sha256).hexdigest()


def read_delivery(headers: Mapping[str, str], body: bytes, secret: bytes) -> WebhookDelivery:
    """The delivery in a request of Gitea, GitHub or GitLab (`headers` with lower-case names); RequestError when the
    signature (401) or the body (400) is wrong."""
    check_signature(headers, body, secret)
    try:
        payload = read_json(body)
    except ValueError as error:
        raise RequestError(400, f"the body is not readable as JSON: {error}") from error
    if not isinstance(payload, dict):
        raise RequestError(400, "the body must be a JSON object")
    delivery = _delivery(headers, payload)
    problems = list(_problems(delivery.payload))
    if problems:
        raise RequestError(400, f"the body is no delivery of a forge: {'; '.join(problems)}")
    return delivery


def check_signature(headers: Mapping[str, str], body: bytes, secret: bytes) -> None:
    """RequestError (401) unless `body` is signed with `secret`."""
    if not _genuine(headers, body, secret):
        problem = "X-Gitea-Signature, X-Hub-Signature-256 or X-Gitlab-Token does not fit"
        raise RequestError(401, f"{problem}: both sides need the same webhook secret")


def _genuine(headers: Mapping[str, str], body: bytes, secret: bytes) -> bool:
    """GitLab sends the secret itself instead of a signature."""
    if "x-gitlab-token" in headers:
        return hmac.compare_digest(headers["x-gitlab-token"].encode(), secret)
    signature = headers.get("x-gitea-signature") or headers.get("x-hub-signature-256", "").removeprefix("sha256=")
    return hmac.compare_digest(signature.encode(), sign(body, secret).encode())


def _delivery(headers: Mapping[str, str], payload: Mapping[str, Any]) -> WebhookDelivery:
    if "x-gitlab-event" in headers:
        return _of_gitlab(payload)
    return WebhookDelivery(headers.get("x-gitea-event") or headers.get("x-github-event", ""), payload)


def _of_gitlab(payload: Mapping[str, Any]) -> WebhookDelivery:
    """A push or merge request event of GitLab; everything else becomes an empty event."""
    project = payload.get("project")
    repository = {"full_name": project.get("path_with_namespace", "") if isinstance(project, dict) else ""}
    if payload.get("object_kind") == "push":
        return WebhookDelivery(
            "push", {"ref": payload.get("ref"), "after": payload.get("after"), "repository": repository}
        )
    request = payload.get("object_attributes")
    if payload.get("object_kind") != "merge_request" or not isinstance(request, dict):
        return WebhookDelivery("", {"repository": repository})
    action = GITLAB_ACTIONS.get(str(request.get("action")), "")
    return WebhookDelivery("pull_request", {"action": action, "repository": repository})


def _problems(payload: Mapping[str, Any]) -> Iterator[str]:
    for path, form in FORMS.items():
        value = _value(payload, path)
        if value is not None and type(value) is not form:
            yield f"{path}: must be {_FORM_WORDS[form]}"


def _value(payload: Mapping[str, Any], path: str) -> Any:
    """What stands at `path`; None when nothing does."""
    value: Any = payload
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return value
