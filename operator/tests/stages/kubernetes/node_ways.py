"""A way from a lone node to a server of this machine: the node's network has nothing but its own loopback address."""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import threading
from collections.abc import Callable, Iterator

CLONE_NEWNET = 0x40000000
PIECE_BYTES = 1 << 16
SECONDS_MAX = 10.0
ACCEPT_SECONDS = 0.5  # after which it looks whether it shall end


class _Way:
    """Passes on what comes to `listener`; `close` ends it with every connection."""

    def __init__(self, listener: socket.socket, port: int) -> None:
        self._listener, self._port = listener, port
        self._connections: list[socket.socket] = []
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []
        self._start(self._accept)

    def close(self) -> None:
        self._ending.set()
        for connection in (self._listener, *self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(SECONDS_MAX)
        for connection in (self._listener, *self._connections):
            connection.close()

    def _start(self, work: Callable[..., None], *arguments: socket.socket) -> None:
        self._threads.append(threading.Thread(target=work, args=arguments, daemon=True))
        self._threads[-1].start()

    def _accept(self) -> None:
        self._listener.settimeout(ACCEPT_SECONDS)
        while not self._ending.is_set():
            try:
                asking, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:
                if self._ending.is_set():
                    return
                raise
            asking.settimeout(None)
            self._connections.append(asking)
            answering = socket.create_connection(("127.0.0.1", self._port), SECONDS_MAX)
            answering.settimeout(None)
            self._connections.append(answering)
            self._start(_copy, asking, answering)
            self._start(_copy, answering, asking)


@contextlib.contextmanager
def way_to(holder: int, port: int) -> Iterator[int]:
    """A port of the node's loopback address that leads to `port` of this machine's; `holder` is the process that holds
    the node's network."""
    made: list[socket.socket] = []
    thread = threading.Thread(target=lambda: made.append(_listening_in(holder)))
    thread.start()  # it alone changes its network, and ends
    thread.join(SECONDS_MAX)
    [listener] = made
    way = _Way(listener, port)
    try:
        yield listener.getsockname()[1]
    finally:
        way.close()


def _listening_in(holder: int) -> socket.socket:
    with open(f"/proc/{holder}/ns/net") as network:  # noqa: PTH123 - the descriptor is what counts
        if ctypes.CDLL(None, use_errno=True).setns(network.fileno(), CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return socket.create_server(("127.0.0.1", 0))


def _copy(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(PIECE_BYTES):
            target.sendall(data)
        target.shutdown(socket.SHUT_WR)
