"""The socket of a connection to the broker, as far as Linux tells and lets: what it holds back, and how much it takes.

TCP_INFO is read by the places of its fields (`struct tcp_info` in linux/tcp.h, which only grows at its end).
"""

from __future__ import annotations

import socket
import struct
from typing import Any, NamedTuple

from robotkube.robots.mqtt.core.send_windows import SendWindow

_INFO_BYTES = 152
_ROUND_TRIP, _UNSENT = 68, 144  # tcpi_rtt; tcpi_notsent_bytes, and tcpi_min_rtt behind it
_NUMBER, _NUMBERS = struct.Struct("=I"), struct.Struct("=II")
_MICROSECOND = 1e-6


class SocketState(NamedTuple):
    """Round trip now and the shortest one, in seconds, and the bytes that wait in the socket for their turn."""

    round_trip: float
    shortest: float
    unsent_bytes: int


def socket_state(connection: Any) -> SocketState:
    """The state of a TCP connection; all zero when the kernel does not tell."""
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO_BYTES)
    except OSError:
        return SocketState(0.0, 0.0, 0)
    if len(info) < _INFO_BYTES:
        return SocketState(0.0, 0.0, 0)
    unsent, shortest = _NUMBERS.unpack_from(info, _UNSENT)
    return SocketState(_NUMBER.unpack_from(info, _ROUND_TRIP)[0] * _MICROSECOND, shortest * _MICROSECOND, unsent)


class SocketBound:
    """The bound of a connection's socket. `bounded`: it takes no more than a window that follows the round trip; else
    as much as the kernel likes."""

    def __init__(self, bounded: bool) -> None:
        self._window = SendWindow() if bounded else None

    def opened(self, connection: Any) -> None:
        """Begin with a new connection."""
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._window is not None:
            self._window = SendWindow()
            _bound(connection, self._window.bytes)

    def full(self, connection: Any, now: float) -> None:
        """Change the bound, for the socket took less than there was; None: it is closed by now."""
        window = self._window
        if window is None or connection is None or not window.due(now):
            return
        state = socket_state(connection)
        before = window.bytes
        window.change(now, state.round_trip, state.shortest)
        if window.bytes != before:
            _bound(connection, window.bytes)


def _bound(connection: Any, size: int) -> None:
    # the kernel counts double, for its own use of memory; what is on its way and what is unsent are bounded together
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size // 2)
