"""The HTTP port of a robot pod: /livez, /readyz, /metrics and pages of the process, on one thread and plain sockets.

The standard library's server costs 18 ms of import and a thread per connection; kubelets and scrapers send one short
GET each, so this answers one connection at a time and closes it.

    server = HealthServer(live=..., ready=..., metrics=..., pages={"/input": input_page}, port=8081)
    server.start()

`live` and `ready` return None when all is well, else a sentence that says what is missing (status 503). `metrics`
returns text in Prometheus' format, a page JSON text. They run on the server's thread and must not block.

`commands` are answered to POST, and only to who speaks from within the pod: whoever may exec into it or forward a port
to it, which the API server decides.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Mapping

REQUEST_BYTES_MAX = 8192
REQUEST_SECONDS_MAX = 2.0
BACKLOG = 16
LOOPBACK = frozenset(["127.0.0.1", "::1", "::ffff:127.0.0.1"])

Command = Callable[[bytes], tuple[int, str]]
"""Body -> status and JSON text."""


def always_well() -> str | None:
    """A state without complaints."""
    return None


class HealthServer:
    """The HTTP server of a robot pod; serves until the process ends or `close` is called. `port` 0 is a free one; see
    `port` after construction."""

    def __init__(
        self,
        live: Callable[[], str | None] = always_well,
        ready: Callable[[], str | None] = always_well,
        metrics: Callable[[], str] = str,
        pages: Mapping[str, Callable[[], str]] | None = None,
        port: int = 8081,
        address: str = "",
        commands: Mapping[str, Command] | None = None,
    ) -> None:
        self._states = {"/livez": live, "/readyz": ready}
        self._metrics = metrics
        self._pages = dict(pages or {})
        self._commands = dict(commands or {})
        self._socket = socket.create_server((address, port), backlog=BACKLOG)
        self._thread = threading.Thread(target=self._serve, name="health", daemon=True)

    @property
    def port(self) -> int:
        """The port in use."""
        return int(self._socket.getsockname()[1])

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def close(self) -> None:
        """Stop answering."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, address = self._socket.accept()
            except OSError:
                return
            with connection, contextlib.suppress(OSError):
                connection.settimeout(REQUEST_SECONDS_MAX)
                head, body = _request(connection)
                connection.sendall(self._response(head.partition("\r\n")[0], body, str(address[0])))

    def _response(self, line: str, sent: bytes, address: str) -> bytes:
        method, _, rest = line.partition(" ")
        path = rest.partition(" ")[0].partition("?")[0]
        if method not in ("GET", "HEAD") and not (method == "POST" and path in self._commands):
            return _message(405, "text/plain", "only GET\n")
        try:
            status, kind, body = self._answer(path) if method != "POST" else self._obey(path, sent, address)
        except Exception as error:  # a page that fails must not end the server
            status = 500
            kind = "text/plain"
            body = f"{path}: {type(error).__name__}: {error}\n"
        return _message(status, kind, body)

    def _obey(self, path: str, sent: bytes, address: str) -> tuple[int, str, str]:
        if address not in LOOPBACK:
            return 403, "text/plain", "commands are accepted from within the pod only: kubectl exec or port-forward\n"
        status, text = self._commands[path](sent)
        return status, "application/json", text + "\n"

    def _answer(self, path: str) -> tuple[int, str, str]:
        if path in self._states:
            complaint = self._states[path]()
            return (200, "text/plain", "ok\n") if complaint is None else (503, "text/plain", f"{complaint}\n")
        if path == "/metrics":
            return 200, "text/plain; version=0.0.4", self._metrics()
        if path in self._pages:
            return 200, "application/json", self._pages[path]()
        return 404, "text/plain", f"no such path; there are {', '.join([*self._states, '/metrics', *self._pages])}\n"


_REASONS = {
    200: "OK",
    202: "Accepted",
    400: "Bad Request",
    403: "Forbidden",
    404: "Not Found",
    405: "Method Not Allowed",
    500: "Internal Server Error",
    503: "Service Unavailable",
}


def _message(status: int, kind: str, body: str) -> bytes:
    data = body.encode()
    head = (
        f"HTTP/1.1 {status} {_REASONS[status]}\r\nContent-Type: {kind}\r\n"
        f"Content-Length: {len(data)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + data


def _request(connection: socket.socket) -> tuple[str, bytes]:
    """Head and body; the head is read to its end, so that closing does not reset the connection."""
    data = b""
    while b"\r\n\r\n" not in data and len(data) < REQUEST_BYTES_MAX and (part := connection.recv(REQUEST_BYTES_MAX)):
        data += part
    head, _, body = data.partition(b"\r\n\r\n")
    text = head.decode("latin-1")
    size = min(_content_length(text), REQUEST_BYTES_MAX)
    while len(body) < size and (part := connection.recv(REQUEST_BYTES_MAX)):
        body += part
    return text, body[:size]


def _content_length(head: str) -> int:
    for line in head.split("\r\n")[1:]:
        name, _, value = line.partition(":")
        if name.strip().lower() == "content-length" and value.strip().isdecimal():
            return int(value)
    return 0
