"""Bounds of an HTTP server on its clients: how many connections each may hold, and how long a request may take to come.

A client that is slow, or means harm, shall take places and time from itself alone.
"""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

CONNECTIONS_MAX = 32
CONNECTIONS_OF_SOURCE_MAX = 12  # of one address; a forge sends up to ten deliveries at a time
HEAD_SECONDS_MAX = 10.0  # for request line and headers together, from their first byte or the connection's beginning
HEAD_BYTES_MAX = 64 * 1024
BODY_SECONDS_MAX = 20.0
IDLE_SECONDS_MAX = 30.0  # between two requests of a connection
ANSWER_SECONDS_MAX = 10.0
REFUSALS_LOGGED_SECONDS = 60.0  # one line in that time, however many are refused

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ConnectionBounds:
    """What the clients of a server may take of it: connections at a time, of all and of one source address, and seconds
    for each part of a request."""

    connections: int = CONNECTIONS_MAX
    connections_of_source: int = CONNECTIONS_OF_SOURCE_MAX
    head_seconds: float = HEAD_SECONDS_MAX
    body_seconds: float = BODY_SECONDS_MAX
    idle_seconds: float = IDLE_SECONDS_MAX
    answer_seconds: float = ANSWER_SECONDS_MAX


class ConnectionPlaces:
    """The places of a server's connections; safe from any thread.

    A source that has all it may have loses its own oldest connection to its next one. When all places are taken, the
    source that has most of them loses its oldest, so that a source with few is never kept out by one with many. The
    connection that found no place is refused: the thread of the one that ends gives its place back by itself, and the
    next attempt has it.
    """

    def __init__(self, bounds: ConnectionBounds, monotonic: Callable[[], float]) -> None:
        self._bounds = bounds
        self._monotonic = monotonic
        self._sources: dict[str, dict[socket.socket, None]] = {}  # those of each source, oldest first
        self._lock = threading.Lock()
        self._refused = 0
        self._logged_at = float("-inf")

    def enter(self, connection: socket.socket, source: str) -> bool:
        """Return whether the connection has got a place."""
        with self._lock:
            own = self._sources.get(source, {})
            most = max(self._sources.values(), key=len, default=own)
            if len(own) >= self._bounds.connections_of_source:
                self._refuse(source, own)
                return False
            if sum(map(len, self._sources.values())) >= self._bounds.connections:
                self._refuse(source, most if len(most) > len(own) + 1 else own)
                return False
            self._sources.setdefault(source, {})[connection] = None
            return True

    def leave(self, connection: socket.socket, source: str) -> None:
        """Give the connection's place back, if it has one."""
        with self._lock:
            own = self._sources.get(source, {})
            own.pop(connection, None)
            if not own:
                self._sources.pop(source, None)

    def end_all(self) -> None:
        """End every connection."""
        with self._lock:
            for connections in self._sources.values():
                for connection in connections:
                    _end(connection)

    def _refuse(self, source: str, connections: dict[socket.socket, None]) -> None:
        """Log that `source` was refused, and end the oldest of `connections`; the next attempt ends another one."""
        self._refused += 1
        now = self._monotonic()
        if now - self._logged_at >= REFUSALS_LOGGED_SECONDS:
            most = f"{self._bounds.connections_of_source} of one address, {self._bounds.connections} in all"
            reason = f"it or all clients have as many as there may be ({most}); find out what keeps them open"
            log.warning("connections refused count=%d last_source=%s reason=%s", self._refused, source, reason)
            self._refused = 0
            self._logged_at = now
        if connections:
            oldest = next(iter(connections))
            connections[oldest] = connections.pop(oldest)
            _end(oldest)


def _end(connection: socket.socket) -> None:
    """End a connection; its thread ends by itself. One by TLS stays so: what its client sent is not read as clear
    text."""
    with contextlib.suppress(OSError):
        socket.socket.shutdown(connection, socket.SHUT_RDWR)


class HeadTooLongError(OSError):
    """Request line and headers of more than HEAD_BYTES_MAX."""


class RequestReader(io.RawIOBase):
    """The bytes that a client sends, all of which must come within a time, however many pieces they come in:
    TimeoutError after that, HeadTooLongError beyond a size, ConnectionResetError where the client ends. Answers may
    take `answer_seconds`."""

    def __init__(self, connection: socket.socket, answer_seconds: float, monotonic: Callable[[], float]) -> None:
        self._connection = connection
        self._answer_seconds = answer_seconds
        self._monotonic = monotonic
        self._deadline = float("-inf")
        self._bytes_left = 0

    def allow(self, seconds: float, bytes_max: int) -> None:
        """Let bytes come from now on, for this long."""
        self._deadline = self._monotonic() + seconds
        self._bytes_left = bytes_max

    def readable(self) -> bool:
        """It is."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Wait for some bytes and put them into `buffer`; their number."""
        seconds = self._deadline - self._monotonic()
        if seconds <= 0:
            raise TimeoutError("the request did not come in time")
        if self._bytes_left <= 0:
            raise HeadTooLongError(f"request line and headers are longer than {HEAD_BYTES_MAX} bytes")
        self._connection.settimeout(seconds)
        try:
            count = self._connection.recv_into(buffer)
        finally:
            self._connection.settimeout(self._answer_seconds)
        if count == 0:  # half a request is none
            raise ConnectionResetError("the client ended the connection")
        self._bytes_left -= count
        return count
