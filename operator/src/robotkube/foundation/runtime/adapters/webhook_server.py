"""The HTTP side of a process: signed webhooks in, health and metrics out.

    POST /webhook   a delivery of the forge: HMAC-SHA256 of the body in X-Gitea-Signature or X-Hub-Signature-256, or the
                    secret in X-Gitlab-Token; 204, or 400/401/413
    GET  /livez     200 while the process serves
    GET  /readyz    200, or 503 with one reason per line
    GET  /metrics   Prometheus text
    GET  <page>     a JSON document of the process, where it offers one
    POST <path>     what the process answers to a question, where it has any; for some the body must be signed as a
                    delivery is, each with a secret of its own: 401 otherwise
    PUT  <path>     what `put` answers, where a process has one

A delivery only wakes its receiver: what happened is read from the forge afterwards, so a lost, doubled or replayed
delivery does no harm. A process that waits for its turn to lead forwards deliveries, pages and questions to the one
that leads (`forward`).
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import logging
import socket
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

GITLAB_ACTIONS = {
    "open": "opened",
    "reopen": "reopened",
    "update": "synchronized",
    "close": "closed",
    "merge": "closed",
}
BODY_BYTES_MAX = 4 * 1024 * 1024
CONNECTIONS_MAX = 32
CONNECTION_SECONDS_MAX = 30.0
SHUTDOWN_SECONDS_MAX = 5.0

log = logging.getLogger(__name__)

Put = Callable[[str, Mapping[str, str], bytes], tuple[int, Mapping[str, Any]]]
"""Path, headers and body -> status and JSON document."""
Post = Callable[[bytes], tuple[int, Mapping[str, Any]]]
"""Body -> status and JSON document."""
Forward = Callable[[str, str, Mapping[str, str], bytes], tuple[int, str, str] | None]
"""Method, path, headers (lower-case names) and body -> status, text and content type of another process's answer; None:
this one answers itself."""


class Signed(NamedTuple):
    """The answering of a post whose body is signed with `secret`, and with no other."""

    secret: bytes
    answer: Post


@dataclass(frozen=True)
class WebhookDelivery:
    """A signed delivery: the forge's event name (push, pull_request, pull_request_sync, ...) and its decoded body."""

    event: str
    payload: Mapping[str, Any]

    @property
    def repository(self) -> str:
        """`<organisation>/<name>`, empty when the payload names none."""
        return str((self.payload.get("repository") or {}).get("full_name", ""))


def sign(body: bytes, secret: bytes) -> str:
    """Hexadecimal HMAC-SHA256 of `body`, as the forge and GitHub compute it."""
    return hmac.new(secret, body, hashlib.sha256).hexdigest()


class _DeliveryError(Exception):
    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


def read_delivery(headers: Mapping[str, str], body: bytes, secret: bytes) -> WebhookDelivery:
    """The delivery in a request of Gitea, GitHub or GitLab; raises with the HTTP status when signature or body are
    wrong. GitLab's events are translated into those of the other two."""
    names = {name.lower(): value for name, value in headers.items()}
    _check(names, body, secret)
    try:
        payload = json.loads(body)
    except ValueError as error:
        raise _DeliveryError(400, f"the body is not JSON: {error}") from error
    if not isinstance(payload, dict):
        raise _DeliveryError(400, "the body must be a JSON object")
    if "x-gitlab-event" in names:
        return _of_gitlab(payload)
    return WebhookDelivery(names.get("x-gitea-event") or names.get("x-github-event", ""), payload)


def _check(names: Mapping[str, str], body: bytes, secret: bytes) -> None:
    if not _genuine(names, body, secret):
        problem = "X-Gitea-Signature, X-Hub-Signature-256 or X-Gitlab-Token does not fit"
        raise _DeliveryError(401, f"{problem}: both sides need the same webhook secret")


def _genuine(names: Mapping[str, str], body: bytes, secret: bytes) -> bool:
    """GitLab sends the secret itself instead of a signature."""
    if "x-gitlab-token" in names:
        return hmac.compare_digest(names["x-gitlab-token"].encode(), secret)
    signature = names.get("x-gitea-signature") or names.get("x-hub-signature-256", "").removeprefix("sha256=")
    return hmac.compare_digest(signature.encode(), sign(body, secret).encode())


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


class WebServer:
    """The HTTP server of a process, on a thread of its own, at most CONNECTIONS_MAX requests at a time; `start()`, then
    `stop()`.

    `deliver` must return at once (it wakes a loop); `ready` gives the reasons why the process is not ready (empty = it
    is); `metrics` gives Prometheus text; `pages` are JSON documents by path, `posts` answer questions by path. Port 0
    is a free one, see `port`. `secret` is that of deliveries; without one there is no /webhook. `signed` are posts
    by path, each with its own secret. `put` gets path, headers (lower-case names) and body of a PUT, and gives status
    and JSON. `forward` may let another process answer genuine deliveries, pages and questions instead.
    """

    def __init__(
        self,
        address: str,
        port: int,
        ready: Callable[[], Sequence[str]],
        metrics: Callable[[], str],
        secret: bytes = b"",
        deliver: Callable[[WebhookDelivery], None] | None = None,
        pages: Mapping[str, Callable[[], Mapping[str, Any]]] | None = None,
        put: Put | None = None,
        posts: Mapping[str, Post] | None = None,
        forward: Forward | None = None,
        signed: Mapping[str, Signed] | None = None,
    ) -> None:
        self._server = _Server((address, port), _Handler)
        self._server.ready = ready
        self._server.metrics = metrics
        self._server.secret = secret
        self._server.deliver = deliver
        self._server.pages = pages or {}
        self._server.put = put
        self._server.posts = posts or {}
        self._server.forward = forward
        self._server.signed = signed or {}
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.2}, daemon=True)

    @property
    def port(self) -> int:
        """The TCP port it listens on."""
        return int(self._server.server_address[1])

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """End within SHUTDOWN_SECONDS_MAX."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join(SHUTDOWN_SECONDS_MAX)
        self._server.server_close()
        self._server.end_connections()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = CONNECTIONS_MAX
    ready: Callable[[], Sequence[str]]
    metrics: Callable[[], str]
    secret: bytes
    deliver: Callable[[WebhookDelivery], None] | None
    pages: Mapping[str, Callable[[], Mapping[str, Any]]]
    put: Put | None
    posts: Mapping[str, Post]
    forward: Forward | None
    signed: Mapping[str, Signed]

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        super().__init__(address, handler)
        self._connections: dict[Any, None] = {}  # oldest first
        self._lock = threading.Lock()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection; drop one beyond the bound and end the oldest, so that no client can hold all places: the
        next try of the forge or the kubelet has one."""
        with self._lock:
            accepted = len(self._connections) < CONNECTIONS_MAX
            if accepted:
                self._connections[request] = None
            else:
                _end(next(iter(self._connections)))
        if accepted:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection on its thread, and give its place back at the end."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._lock:
                self._connections.pop(request, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error with its trace, but for clients that closed their connection."""
        if not isinstance(sys.exception(), OSError):
            log.error("request failed client=%s", client_address, exc_info=True)

    def end_connections(self) -> None:
        """End kept connections: a delivery must not go to a process that has stopped listening."""
        with self._lock:
            for connection in self._connections:
                _end(connection)


def _end(connection: Any) -> None:
    """End a connection; its thread ends by itself, and gives the place back."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    timeout = CONNECTION_SECONDS_MAX
    server_version = "robotkube"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer health, metrics and pages."""
        if self.path == "/livez":
            self._answer(200, "ok\n")
        elif self.path == "/readyz":
            reasons = self.server.ready()
            self._answer(503 if reasons else 200, "".join(f"{reason}\n" for reason in reasons) or "ok\n")
        elif self.path == "/metrics":
            self._answer(200, self.server.metrics())
        elif self.path not in self.server.pages:
            self._answer(404, "not found\n")
        elif not self._forwarded(b""):
            self._answer(200, json.dumps(self.server.pages[self.path]()) + "\n", "application/json")

    def do_POST(self) -> None:
        """Answer a delivery, or a question."""
        if self.path in self.server.posts:
            self._reply(self.server.posts[self.path])
            return
        if self.path in self.server.signed:
            signed = self.server.signed[self.path]
            self._reply(signed.answer, signed.secret)
            return
        if self.path != "/webhook" or self.server.deliver is None:
            self._refuse(404, "not found")
            return
        try:
            body = self._body()
            delivery = read_delivery(dict(self.headers), body, self.server.secret)
        except _DeliveryError as error:
            log.warning("webhook refused status=%d reason=%s", error.status, error)
            self._refuse(error.status, str(error))
            return
        log.debug("delivery event=%s action=%s", delivery.event, delivery.payload.get("action", ""))
        if not self._forwarded(body):
            self.server.deliver(delivery)
            self._answer(204, "")

    def do_PUT(self) -> None:
        """Answer a request, where the process has `put`."""
        if self.server.put is None:
            self._refuse(404, "not found")
            return
        put = self.server.put
        headers = self._lower_case_headers()
        self._reply(lambda body: put(self.path, headers, body))

    def _reply(self, reply: Post, secret: bytes | None = None) -> None:
        """Answer a request by its body, signed when there is a secret for it."""
        try:
            body = self._body()
            if secret is not None:
                _check(self._lower_case_headers(), body, secret)
        except _DeliveryError as error:
            self._refuse(error.status, str(error))
            return
        if self._forwarded(body):
            return
        status, document = reply(body)
        self._answer(status, json.dumps(document) + "\n", "application/json")

    def _forwarded(self, body: bytes) -> bool:
        """Whether another process has answered this request."""
        forward = self.server.forward
        answer = forward(self.command, self.path, self._lower_case_headers(), body) if forward is not None else None
        if answer is not None:
            self._answer(*answer)
        return answer is not None

    def _lower_case_headers(self) -> dict[str, str]:
        return {name.lower(): value for name, value in self.headers.items()}

    def _body(self) -> bytes:
        length = self.headers.get("Content-Length") or ""
        if not length.isascii() or not length.isdigit():
            raise _DeliveryError(411, "Content-Length is missing")
        if int(length) > BODY_BYTES_MAX:
            raise _DeliveryError(413, f"longer than {BODY_BYTES_MAX} bytes")
        return self.rfile.read(int(length))

    def _refuse(self, status: int, message: str) -> None:
        self.close_connection = True  # the body may not have been read
        self._answer(status, message + "\n")

    def _answer(self, status: int, text: str, kind: str = "text/plain; charset=utf-8") -> None:
        body = text.encode()
        self.send_response(status)
        if self.close_connection:
            self.send_header("Connection", "close")
        if status != 204:
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if status != 204:
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class names it so
        """No access log: one canonical line per unit of work comes from the services."""
