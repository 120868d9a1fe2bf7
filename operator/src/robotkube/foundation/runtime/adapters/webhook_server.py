"""The HTTP side of a process: signed webhooks in, health and metrics out.

    POST /webhook   a delivery of the forge: HMAC-SHA256 of the body in X-Gitea-Signature or X-Hub-Signature-256, or the
                    secret in X-Gitlab-Token; 204, or 400/401/408/411/413
    GET  /livez     200 while the process serves
    GET  /readyz    200, or 503 with one reason per line
    GET  /metrics   Prometheus text
    GET  <page>     a JSON document of the process, where it offers one
    POST <path>     what the process answers to a question, where it has any; for some the body must be signed as a
                    delivery is, each with a secret of its own: 401 otherwise
    PUT  <path>     what `put` answers, where a process has one

The first three are also answered on a port of their own, for kubelet and Prometheus: clients of the other port cannot
take its places. How many connections, and how much time, a client may take: `bounded_connections`.

A delivery only wakes its receiver: what happened is read from the forge afterwards, so a lost, doubled or replayed
delivery does no harm. A process that waits for its turn to lead forwards deliveries, pages and questions to the one
that leads (`forward`).
"""

from __future__ import annotations

import io
import json
import logging
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple

from robotkube.foundation.runtime.adapters.bounded_connections import (
    HEAD_BYTES_MAX,
    ConnectionBounds,
    ConnectionPlaces,
    HeadTooLongError,
    RequestReader,
)
from robotkube.foundation.runtime.adapters.served_certificate import ServedCertificate, greet
from robotkube.foundation.runtime.core.webhook_deliveries import (
    RequestError,
    WebhookDelivery,
    check_signature,
    read_delivery,
)

BODY_BYTES_MAX = 4 * 1024 * 1024
LENGTH_DIGITS_MAX = 20  # of Content-Length
SHUTDOWN_SECONDS_MAX = 5.0
POLL_SECONDS = 0.2

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
class _Answers:
    """What is answered on one port."""

    live: Callable[[], bool]
    ready: Callable[[], Sequence[str]]
    metrics: Callable[[], str]
    secret: bytes = b""
    deliver: Callable[[WebhookDelivery], None] | None = None
    pages: Mapping[str, Callable[[], Mapping[str, Any]]] = field(default_factory=dict)
    put: Put | None = None
    posts: Mapping[str, Post] = field(default_factory=dict)
    forward: Forward | None = None
    signed: Mapping[str, Signed] = field(default_factory=dict)


class WebServer:
    """The HTTP server of a process, each connection on a thread of its own within `bounds`; `start()`, then `stop()`.

    `deliver` must return at once (it wakes a loop); `ready` gives the reasons why the process is not ready (empty = it
    is); `metrics` gives Prometheus text; `pages` are JSON documents by path, `posts` answer questions by path. Port 0
    is a free one, see `ports`. `secret` is that of deliveries; without one there is no /webhook. `signed` are posts
    by path, each with its own secret. `put` gets path, headers (lower-case names) and body of a PUT, and gives status
    and JSON. `forward` may let another process answer genuine deliveries, pages and questions instead. At
    `health_port`, if there is one, only health and metrics are answered, in places of its own, and always by HTTP;
    everything else by HTTPS where `certificate` names a folder with tls.crt and tls.key (InputError when they are not
    there).
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
        health_port: int | None = None,
        certificate: Path | None = None,
        bounds: ConnectionBounds = ConnectionBounds(),  # noqa: B008 - it is frozen
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        more = (secret, deliver, pages or {}, put, posts or {}, forward, signed or {})
        answers = _Answers(self._is_serving, ready, metrics, *more)
        served = None if certificate is None else ServedCertificate(certificate)
        self._servers = {"port": _Server(address, port, answers, bounds, monotonic, served)}
        if health_port is not None:
            health = _Answers(self._is_serving, ready, metrics)
            self._servers["health_port"] = _Server(address, health_port, health, bounds, monotonic)

    @property
    def ports(self) -> Mapping[str, int]:
        """The TCP ports it listens on: `port`, and `health_port` where it has one."""
        return {name: server.port for name, server in self._servers.items()}

    @property
    def port(self) -> int:
        """The TCP port of deliveries and questions."""
        return self._servers["port"].port

    def start(self) -> None:
        """Begin to serve."""
        for server in self._servers.values():
            server.start()

    def stop(self) -> None:
        """End within SHUTDOWN_SECONDS_MAX for each port."""
        for server in self._servers.values():
            server.stop()

    def _is_serving(self) -> bool:
        return self._servers["port"].is_serving()


class _Server(ThreadingHTTPServer):
    """One port of a WebServer."""

    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        address: str,
        port: int,
        answers: _Answers,
        bounds: ConnectionBounds,
        monotonic: Callable[[], float],
        certificate: ServedCertificate | None = None,
    ) -> None:
        self.answers = answers
        self._certificate = certificate
        self.bounds = bounds
        self.monotonic = monotonic
        self.request_queue_size = bounds.connections
        self._places = ConnectionPlaces(bounds, monotonic)
        super().__init__((address, port), _Handler)
        self._thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": POLL_SECONDS}, daemon=True)

    @property
    def port(self) -> int:
        """The TCP port it listens on."""
        return int(self.server_address[1])

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def is_serving(self) -> bool:
        """Return whether it accepts connections."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """End, and end kept connections: a delivery must not go to a process that has stopped listening."""
        if self._thread.is_alive():
            with suppress(OSError):
                self.socket.shutdown(socket.SHUT_RDWR)  # ends the wait for a connection, of up to POLL_SECONDS
            self.shutdown()
            self._thread.join(SHUTDOWN_SECONDS_MAX)
        self.server_close()
        self._places.end_all()

    def get_request(self) -> tuple[Any, Any]:
        """Accept a connection."""
        request, client_address = super().get_request()
        return request if self._certificate is None else self._certificate.wrap(request), client_address

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection that has a place, drop one that has none."""
        source = str(client_address[0])
        if not self._places.enter(request, source):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # there was no thread
            self._places.leave(request, source)
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection on its thread, and give its place back at the end."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.leave(request, str(client_address[0]))

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Answer what a connection asks, on its thread."""
        if self._certificate is not None:
            greet(request, self.bounds.head_seconds)
        super().finish_request(request, client_address)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error with its trace, but for clients that closed their connection, or had it ended."""
        if not isinstance(sys.exception(), OSError):
            log.error("request failed client=%s", client_address, exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version = "robotkube"
    sys_version = ""
    disable_nagle_algorithm = True  # head and body of an answer go one after the other: the second waited for 40 ms

    def setup(self) -> None:
        """Read what the client sends within the server's bounds."""
        super().setup()
        self.rfile.close()
        self._incoming = RequestReader(self.connection, self.server.bounds.answer_seconds, self.server.monotonic)
        self.rfile = io.BufferedReader(self._incoming)

    def handle(self) -> None:
        """Answer the requests of a connection, one after the other."""
        self.close_connection = True
        self._answer_one()
        while not self.close_connection and self._next_begins():
            self._answer_one()

    def _answer_one(self) -> None:
        self._incoming.allow(self.server.bounds.head_seconds, HEAD_BYTES_MAX)
        self.handle_one_request()

    def _next_begins(self) -> bool:
        """Return whether the client sends another request before it was idle for too long."""
        self._incoming.allow(self.server.bounds.idle_seconds, HEAD_BYTES_MAX)
        try:
            return bool(self.rfile.peek(1))  # type: ignore[attr-defined]
        except (TimeoutError, ConnectionError):
            return False

    def parse_request(self) -> bool:
        """Read request line and headers; a client whose headers are late or too long is told so."""
        try:
            return super().parse_request()
        except TimeoutError:
            seconds = self.server.bounds.head_seconds
            self._refuse(408, f"request line and headers did not come within {seconds:g} s; send them at once")
        except HeadTooLongError as error:
            self._refuse(431, str(error))
        return False

    def do_GET(self) -> None:
        """Answer health, metrics and pages."""
        answers = self.server.answers
        if self.path == "/livez":
            self._answer_health(
                [] if answers.live() else ["the port of deliveries and questions has stopped to answer"]
            )
        elif self.path == "/readyz":
            self._answer_health(answers.ready())
        elif self.path == "/metrics":
            self._answer(200, answers.metrics())
        elif self.path not in answers.pages:
            self._answer(404, "not found\n")
        elif not self._forwarded(b""):
            self._answer(200, json.dumps(answers.pages[self.path]()) + "\n", "application/json")

    def _answer_health(self, reasons: Sequence[str]) -> None:
        self._answer(503 if reasons else 200, "".join(f"{reason}\n" for reason in reasons) or "ok\n")

    def do_POST(self) -> None:
        """Answer a delivery, or a question."""
        answers = self.server.answers
        if self.path in answers.posts:
            self._reply(answers.posts[self.path])
        elif self.path in answers.signed:
            self._reply(answers.signed[self.path].answer, answers.signed[self.path].secret)
        elif self.path == "/webhook" and answers.deliver is not None:
            self._receive(answers.deliver)
        else:
            self._refuse(404, "not found")

    def _receive(self, deliver: Callable[[WebhookDelivery], None]) -> None:
        """Answer a delivery."""
        try:
            body = self._body()
            delivery = read_delivery(self._lower_case_headers(), body, self.server.answers.secret)
        except RequestError as error:
            log.warning("webhook refused status=%d reason=%s", error.status, error)
            self._refuse(error.status, str(error))
            return
        log.debug("delivery kind=%s action=%s", delivery.event, delivery.payload.get("action", ""))
        if not self._forwarded(body):
            deliver(delivery)
            self._answer(204, "")

    def do_PUT(self) -> None:
        """Answer a request, where the process has `put`."""
        put = self.server.answers.put
        if put is None:
            self._refuse(404, "not found")
            return
        headers = self._lower_case_headers()
        self._reply(lambda body: put(self.path, headers, body))

    def _reply(self, reply: Post, secret: bytes | None = None) -> None:
        """Answer a request by its body, signed when there is a secret for it."""
        try:
            body = self._body()
            if secret is not None:
                check_signature(self._lower_case_headers(), body, secret)
        except RequestError as error:
            self._refuse(error.status, str(error))
            return
        if self._forwarded(body):
            return
        status, document = reply(body)
        self._answer(status, json.dumps(document) + "\n", "application/json")

    def _forwarded(self, body: bytes) -> bool:
        """Return whether another process has answered this request."""
        forward = self.server.answers.forward
        answer = forward(self.command, self.path, self._lower_case_headers(), body) if forward is not None else None
        if answer is not None:
            self._answer(*answer)
        return answer is not None

    def _lower_case_headers(self) -> dict[str, str]:
        return {name.lower(): value for name, value in self.headers.items()}

    def _body(self) -> bytes:
        """The body, whose length must be known, all of which must come in time."""
        length = self.headers.get("Content-Length") or ""
        if not length.isascii() or not length.isdigit():
            raise RequestError(411, "Content-Length is missing")
        if len(length) > LENGTH_DIGITS_MAX or int(length) > BODY_BYTES_MAX:
            raise RequestError(413, f"longer than {BODY_BYTES_MAX} bytes")
        seconds = self.server.bounds.body_seconds
        self._incoming.allow(seconds, BODY_BYTES_MAX + io.DEFAULT_BUFFER_SIZE)
        try:
            return self.rfile.read(int(length))
        except TimeoutError as error:
            raise RequestError(408, f"the body did not come within {seconds:g} s; send it at once") from error

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
