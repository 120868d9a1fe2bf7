"""Deliveries of forges: what is signed and of the form that receivers read; everything else is refused with words."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given

from robotkube.foundation.runtime.core.webhook_deliveries import (
    FORMS,
    RequestError,
    WebhookDelivery,
    read_delivery,
    sign,
)
from tests.stages.random_json import mistaken

SECRET = b"shared"
PULL_REQUEST = {"number": 7, "merged": False, "user": {"login": "manager"}, "head": {"sha": "f" * 40}}
PAYLOAD = {
    "action": "opened",
    "ref": "refs/heads/main",
    "after": "0" * 40,
    "repository": {"full_name": "robotkube/deployment"},
    "pull_request": PULL_REQUEST,
    "issue": {"number": 7},
}
GITLAB = {
    "object_kind": "merge_request",
    "ref": "refs/heads/main",
    "after": "0" * 40,
    "project": {"path_with_namespace": "robotkube/deployment"},
    "object_attributes": {"action": "merge"},
}


def read(body: bytes, event: str = "push") -> WebhookDelivery:
    return read_delivery({"x-gitea-event": event, "x-gitea-signature": sign(body, SECRET)}, body, SECRET)


def read_gitlab(body: bytes) -> WebhookDelivery:
    return read_delivery({"x-gitlab-event": "any", "x-gitlab-token": SECRET.decode()}, body, SECRET)


def received(reads: Callable[[bytes], WebhookDelivery], document: Any) -> WebhookDelivery | None:
    """The delivery; None when it is refused for its form."""
    try:
        return reads(json.dumps(document).encode())
    except RequestError as error:
        if error.status != 400:
            raise
        return None


def refused(body: bytes) -> str:
    with pytest.raises(RequestError) as refusal:
        read(body)
    assert refusal.value.status == 400
    return str(refusal.value)


def test_a_delivery_of_the_form_is_read() -> None:
    delivery = read(json.dumps(PAYLOAD).encode())
    assert delivery == WebhookDelivery("push", PAYLOAD)
    assert delivery.repository == "robotkube/deployment"


@pytest.mark.parametrize(
    "missing", [{}, dict.fromkeys(PAYLOAD), {"repository": {}}, {"repository": {"full_name": None}}]
)
def test_what_is_missing_or_null_is_no_problem(missing: dict[str, Any]) -> None:
    assert read(json.dumps(missing).encode()).repository == ""


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        ({"repository": 7}, "repository: must be an object"),
        ({"repository": {"full_name": 3}}, "repository.full_name: must be text"),
        ({"repository": {"full_name": {}}}, "repository.full_name: must be text"),
        ({"action": ["opened"]}, "action: must be text"),
        ({"pull_request": {"number": True}}, "pull_request.number: must be a whole number"),
        ({"pull_request": {"merged": 1}}, "pull_request.merged: must be true or false"),
        ({"pull_request": {"user": []}, "issue": 0}, "pull_request.user: must be an object; issue: must be an object"),
        ([], "the body must be a JSON object"),
        (7, "the body must be a JSON object"),
        ("text", "the body must be a JSON object"),
        (None, "the body must be a JSON object"),
    ],
)
def test_another_form_is_refused(payload: Any, words: str) -> None:
    assert refused(json.dumps(payload).encode()).endswith(words)


@pytest.mark.parametrize("body", [b"[" * 100_000, b'{"a":' * 100_000, b"[" * 101 + b"]" * 101])
def test_a_deep_body_is_refused(body: bytes) -> None:
    assert refused(body) == "the body is not readable as JSON: nested deeper than 100 levels; write it flatter"


@pytest.mark.parametrize("body", [b"", b"{", b"\xff", b'{"a": ' + b"9" * 5000 + b"}"])
def test_what_is_no_json_is_refused(body: bytes) -> None:
    assert refused(body).startswith("the body is not readable as JSON: ")


@given(mistaken(PAYLOAD))
def test_any_document_is_refused_or_has_the_form(document: Any) -> None:
    delivery = received(read, document)
    if delivery is None:
        return
    assert isinstance(delivery.repository, str)
    for path, form in FORMS.items():
        value: Any = delivery.payload
        for key in path.split("."):
            value = None if value is None else value.get(key)
        assert value is None or type(value) is form


@given(mistaken(GITLAB))
def test_any_document_of_gitlab_is_refused_or_has_the_form(document: Any) -> None:
    delivery = received(read_gitlab, document)
    assert delivery is None or isinstance(delivery.repository, str)


@pytest.mark.parametrize(
    ("event", "repository", "payload", "tip"),
    [
        ("push", "a/b", {"ref": "refs/heads/main", "after": "c" * 40}, "c" * 40),
        ("push", "a/b", {"ref": "refs/heads/main"}, ""),
        ("push", "a/b", {"ref": "refs/heads/other", "after": "c" * 40}, None),
        ("push", "a/c", {"ref": "refs/heads/main", "after": "c" * 40}, None),
        ("pull_request", "a/b", {"ref": "refs/heads/main", "after": "c" * 40}, None),
    ],
)
def test_a_delivery_says_where_a_branch_moved_to(
    event: str, repository: str, payload: dict[str, str], tip: str | None
) -> None:
    delivery = WebhookDelivery(event, {**payload, "repository": {"full_name": repository}})
    assert delivery.moved_to("a/b", "main") == tip
