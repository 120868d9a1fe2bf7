"""A forge that is known by its address alone, reached by a name that its certificate has.

libgit2 compares names with certificates as it should, addresses not: it takes any other one (1.9.4). So Git asks for
`localhost`, which every forge of the platform has in its certificate, and a relay in this process passes on the bytes.
"""

from __future__ import annotations

import contextlib
import functools
import socket
import socketserver
import threading
from typing import Any
from urllib.parse import urlsplit

NAME = "localhost"
CONNECT_SECONDS_MAX = 10.0
PIECE_BYTES = 1 << 18


@functools.cache
def by_name(url: str) -> str:
    """The URL by which the forge at `url` is reached from this process, as long as it runs."""
    address = urlsplit(url)
    relay = _Relay((address.hostname or "", address.port or 443))
    threading.Thread(target=relay.serve_forever, daemon=True).start()
    return f"{address.scheme}://{NAME}:{relay.server_address[1]}"


class _Relay(socketserver.ThreadingTCPServer):
    daemon_threads = True

    def __init__(self, forge: tuple[str, int]) -> None:
        self.forge = forge
        super().__init__(("127.0.0.1", 0), _Connection)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: who asked sees the end of his connection."""


class _Connection(socketserver.BaseRequestHandler):
    server: _Relay

    def handle(self) -> None:
        with socket.create_connection(self.server.forge, CONNECT_SECONDS_MAX) as there:
            there.settimeout(None)
            back = threading.Thread(target=_pass_on, args=(there, self.request), daemon=True)
            back.start()
            _pass_on(self.request, there)
            back.join()


def _pass_on(source: socket.socket, target: socket.socket) -> None:
    """Pass on what comes until its end, and then that."""
    with contextlib.suppress(OSError):
        while piece := source.recv(PIECE_BYTES):
            target.sendall(piece)
    with contextlib.suppress(OSError):
        target.shutdown(socket.SHUT_WR)
