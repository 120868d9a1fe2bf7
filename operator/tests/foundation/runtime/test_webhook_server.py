"""The HTTP side of a process over real sockets: signatures, health, metrics, bounds."""

import json
import socket
from collections.abc import Iterator

import httpx
import pytest

from robotkube.foundation.runtime.adapters.bounded_connections import CONNECTIONS_OF_SOURCE_MAX
from robotkube.foundation.runtime.adapters.webhook_server import BODY_BYTES_MAX, WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery, sign
from tests.stages import http_calls

SECRET = b"shared"


class Receiver:
    def __init__(self) -> None:
        self.deliveries: list[WebhookDelivery] = []
        self.reasons: list[str] = []
        self.server = WebServer(
            "127.0.0.1", 0, lambda: self.reasons, lambda: "things 1\n", SECRET, self.deliveries.append
        )
        self.server.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.port}"


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    started = Receiver()
    yield started
    started.server.stop()


def deliver(receiver: Receiver, body: bytes, signature: str | None = None) -> httpx.Response:
    headers = {"X-Gitea-Event": "push", "X-Gitea-Signature": sign(body, SECRET) if signature is None else signature}
    return http_calls.post(f"{receiver.url}/webhook", content=body, headers=headers)


def test_a_signed_delivery_arrives(receiver: Receiver) -> None:
    body = json.dumps({"after": "x", "repository": {"full_name": "robotkube/deployment"}}).encode()
    assert deliver(receiver, body).status_code == 204
    assert receiver.deliveries == [WebhookDelivery("push", json.loads(body))]
    assert receiver.deliveries[0].repository == "robotkube/deployment"


def test_deliveries_of_github_and_gitlab_arrive_in_the_same_words(receiver: Receiver) -> None:
    body = json.dumps({"ref": "refs/heads/main", "after": "x", "repository": {"full_name": "a/b"}}).encode()
    signature = f"sha256={sign(body, SECRET)}"
    hub = {"X-GitHub-Event": "push", "X-Hub-Signature-256": signature}
    lab = {"X-Gitlab-Event": "Push Hook", "X-Gitlab-Token": SECRET.decode()}
    project = {"path_with_namespace": "a/b"}
    pushed = {"object_kind": "push", "ref": "refs/heads/main", "after": "x", "project": project}
    closed = {"object_kind": "merge_request", "project": project, "object_attributes": {"iid": 1, "action": "merge"}}
    asked = [(hub, body), *((lab, json.dumps(payload).encode()) for payload in (pushed, closed, {"project": 7}))]
    for headers, content in asked:
        assert http_calls.post(f"{receiver.url}/webhook", content=content, headers=headers).status_code == 204
    push = WebhookDelivery("push", json.loads(body))
    closing = WebhookDelivery("pull_request", {"action": "closed", "repository": {"full_name": "a/b"}})
    assert receiver.deliveries == [push, push, closing, WebhookDelivery("", {"repository": {"full_name": ""}})]
    wrong = {**lab, "X-Gitlab-Token": "another"}
    assert http_calls.post(f"{receiver.url}/webhook", content=body, headers=wrong).status_code == 401


@pytest.mark.parametrize(
    ("body", "signature", "status"),
    [
        *((b"{}", "", 401), (b"{}", "0" * 64, 401), (b"[]", None, 400), (b"{", None, 400)),
        *((b"[" * 100_000, None, 400), (b'{"repository": 7}', None, 400)),
        *((b'{"repository": {"full_name": 3}}', None, 400), (b'{"action": []}', None, 400)),
    ],
)
def test_what_is_refused(receiver: Receiver, body: bytes, signature: str | None, status: int) -> None:
    assert deliver(receiver, body, signature).status_code == status
    assert receiver.deliveries == []


def test_a_signature_that_is_no_ascii_is_refused(receiver: Receiver) -> None:
    request = b"POST /webhook HTTP/1.1\r\nHost: x\r\nX-Gitea-Signature: \xfc\r\nContent-Length: 2\r\n\r\n{}"
    assert raw(receiver, request).startswith(b"HTTP/1.1 401")


def test_a_body_that_is_too_long_or_has_no_length_is_refused(receiver: Receiver) -> None:
    start = b"POST /webhook HTTP/1.1\r\nHost: x\r\n"
    assert raw(receiver, start + f"Content-Length: {BODY_BYTES_MAX + 1}\r\n\r\n".encode()).startswith(b"HTTP/1.1 413")
    assert raw(receiver, start + b"\r\n").startswith(b"HTTP/1.1 411")
    assert raw(receiver, start + b"Content-Length: -1\r\n\r\n").startswith(b"HTTP/1.1 411")
    assert raw(receiver, start + b"Content-Length: " + b"9" * 5000 + b"\r\n\r\n").startswith(b"HTTP/1.1 413")


def raw(receiver: Receiver, request: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", receiver.server.port), timeout=5) as connection:
        connection.sendall(request)
        return connection.recv(200)


def test_health_and_metrics(receiver: Receiver) -> None:
    with http_calls.client(base_url=receiver.url) as client:
        assert client.get("/livez").status_code == 200
        assert client.get("/readyz").text == "ok\n"
        receiver.reasons.append("the forge was not seen for 40 s")
        answer = client.get("/readyz")
        assert (answer.status_code, answer.text) == (503, "the forge was not seen for 40 s\n")
        assert client.get("/livez").status_code == 200
        assert client.get("/metrics").text == "things 1\n"
        assert client.get("/other").status_code == 404
        assert client.post("/other").status_code == 404


def test_connections_are_bounded_and_end_with_the_server() -> None:
    receiver = Receiver()
    address = ("127.0.0.1", receiver.server.port)
    held = [socket.create_connection(address, timeout=5) for _ in range(CONNECTIONS_OF_SOURCE_MAX)]
    try:
        for connection in held:  # each one is served and kept open
            connection.sendall(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n")
            assert connection.recv(200).startswith(b"HTTP/1.1 200")
        assert raw(receiver, b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n") == b""
        receiver.server.stop()
        for connection in held:
            while connection.recv(4096):  # what was left of the first answer
                continue
    finally:
        for connection in held:
            connection.close()
