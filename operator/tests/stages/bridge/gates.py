"""A way to the broker that can be shut for a connection: nothing of it is read then, so its sender cannot go on."""

from __future__ import annotations

import selectors
import socket
import threading
from collections import Counter

from robotkube.robots.bridge.core.settings import CHANNELS

RECEIVE_BYTES = 16 * 1024
BUFFER_BYTES = 8 * 1024
"""Of the sockets that stand for the network: what a shut connection can still lose into them."""


class Gates:
    """Forwards connections to a port. `shut`: words in the names of clients that do not get through; `forwarded`: bytes
    to the broker, by client."""

    def __init__(self, target: int) -> None:
        self.shut: set[str] = set()
        self.forwarded: Counter[str] = Counter()
        self._target = target
        self._listening = socket.socket()
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._listening.bind(("127.0.0.1", 0))
        self._listening.listen()
        self.port: int = self._listening.getsockname()[1]
        self._peers: dict[socket.socket, socket.socket] = {}
        self._names: dict[socket.socket, str] = {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gates", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections."""
        self._ended.set()
        self._thread.join()
        for one in (self._listening, *self._peers):
            one.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            with selectors.DefaultSelector() as selector:
                for one in (self._listening, *self._peers):
                    if not any(word in self._names.get(one, "") for word in self.shut):
                        selector.register(one, selectors.EVENT_READ)
                readable = [key.fileobj for key, _ in selector.select(0.01)]
            for one in readable:
                assert isinstance(one, socket.socket)
                self._accept() if one is self._listening else self._forward(one)

    def _accept(self) -> None:
        client, _ = self._listening.accept()
        broker = socket.create_connection(("127.0.0.1", self._target))
        self._peers |= {client: broker, broker: client}

    def _forward(self, one: socket.socket) -> None:
        peer = self._peers.get(one)
        if peer is None:
            return
        try:
            data = one.recv(RECEIVE_BYTES)
            peer.sendall(data)
        except OSError:
            data = b""
        if not data:
            for end in (one, peer):
                self._peers.pop(end, None)
                end.close()
        elif one.getsockname()[1] == self.port:
            name = self._names.setdefault(one, data[:100].decode("latin-1"))
            self.forwarded[next((kind for kind in CHANNELS if f"-{kind}" in name), "")] += len(data)
