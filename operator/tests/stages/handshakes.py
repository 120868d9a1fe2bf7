"""TLS servers in this process: for one handshake each, and for requests by HTTPS."""

from __future__ import annotations

import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from robotkube.foundation.certificates.adapters.issuing import issue
from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context
from robotkube.foundation.certificates.core.lives import Pair

SECONDS_MAX = 10.0
LIFE_SECONDS = 3600.0


def written(folder: Path, pair: Pair) -> Path:
    """The file of an authority's certificate."""
    folder.mkdir(exist_ok=True)
    (folder / "ca.crt").write_text(pair.certificate)
    return folder / "ca.crt"


def certified(folder: Path, authority: Pair, *names: str) -> Path:
    """The folder with a certificate of this authority for these names, and with its key."""
    _keep(folder, issue(authority, names, time.time(), LIFE_SECONDS))
    return folder


def _keep(folder: Path, pair: Pair) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "tls.crt").write_text(pair.certificate)
    (folder / "tls.key").write_text(pair.key)


def server_context(folder: Path, pair: Pair) -> ssl.SSLContext:
    """Shows this certificate."""
    _keep(folder, pair)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "tls.crt", folder / "tls.key")
    return context


def handshake(server: ssl.SSLContext | None, verification: ServerVerification) -> str:
    """The version of TLS that both agreed on; the client's error is raised. Without a context the server answers in
    clear text."""
    here, there = socket.socketpair()
    for end in (here, there):
        end.settimeout(SECONDS_MAX)

    def serve() -> None:
        try:
            if server is None:
                there.recv(1024)
                there.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            else:
                server.wrap_socket(there, server_side=True).close()
        except OSError:
            pass
        finally:
            there.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with client_context(verification).wrap_socket(here) as encrypted:
            return str(encrypted.version())
    finally:
        here.close()
        thread.join(SECONDS_MAX)


@contextmanager
def answering(server: ssl.SSLContext) -> Iterator[str]:
    """The URL, by the name localhost, of a server that answers every request with `yes`, on a connection for each."""

    class Answers(BaseHTTPRequestHandler):
        def setup(self) -> None:
            self.request = server.wrap_socket(self.request, server_side=True)
            super().setup()

        def finish(self) -> None:
            super().finish()
            self.request.close()

        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "3")
            self.end_headers()
            self.wfile.write(b"yes")

        def log_message(self, format: str, *_: Any) -> None:  # noqa: A002
            pass

    class Quiet(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, request: Any, client_address: Any) -> None:
            """Clients that refuse its certificate are what it is for."""

    running = Quiet(("127.0.0.1", 0), Answers)
    thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"https://localhost:{running.server_address[1]}"
    finally:
        running.shutdown()
        running.server_close()
        thread.join(SECONDS_MAX)
