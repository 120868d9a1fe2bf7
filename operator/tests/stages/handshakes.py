"""A TLS server in this process, for one handshake each."""

from __future__ import annotations

import socket
import ssl
import threading
from pathlib import Path

from robotkube.foundation.certificates.adapters.verification import ServerVerification, client_context
from robotkube.foundation.certificates.core.lives import Pair

SECONDS_MAX = 10.0


def written(folder: Path, pair: Pair) -> Path:
    """The file of an authority's certificate."""
    folder.mkdir(exist_ok=True)
    (folder / "ca.crt").write_text(pair.certificate)
    return folder / "ca.crt"


def server_context(folder: Path, pair: Pair) -> ssl.SSLContext:
    """Shows this certificate."""
    folder.mkdir(exist_ok=True)
    (folder / "tls.crt").write_text(pair.certificate)
    (folder / "tls.key").write_text(pair.key)
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
