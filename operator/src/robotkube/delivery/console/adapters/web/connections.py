"""Bounds of the console on its clients, below HTTP: how many connections each may hold, how long a request may take to
come, and how long an answer may wait for its reader.

A client that is slow, or means harm, shall take places from itself alone. What one may ask: `guarding`.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

from robotkube.errors import InputError

REFUSALS_LOGGED_SECONDS = 60.0

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WebBounds:
    """What a client may take: connections of one address at a time, seconds for a request to come (from the
    connection's beginning, or the last answer), and seconds in which it takes nothing of an answer."""

    connections_of_source: int = 100  # a browser opens up to six, and a stream for each window
    request_seconds: float = 20.0
    stalled_seconds: float = 60.0


class BoundedConnection(H11Protocol):
    """A connection within `bounds`; those of `proxies` may be as many as they like, since each is of many people."""

    bounds: ClassVar[WebBounds] = WebBounds()
    proxies: ClassVar[Sequence[Network]] = ()
    refused: ClassVar[int] = 0  # since it was logged last
    logged_next: ClassVar[float] = 0.0

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._request: asyncio.TimerHandle | None = None
        self._answer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Take the connection, unless its source has all that it may."""
        super().connection_made(transport)
        if self._is_one_too_many():
            self.connections.discard(self)
            transport.abort()
            self._log_refusals()
        else:
            self._expect_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the timers with it."""
        _cancel(self._request)
        _cancel(self._answer)
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._expect_request()
        super().on_response_complete()

    def pause_writing(self) -> None:
        """Its reader takes nothing."""
        self._answer = self.loop.call_later(self.bounds.stalled_seconds, self.transport.abort)
        super().pause_writing()

    def resume_writing(self) -> None:
        """Its reader goes on."""
        _cancel(self._answer)
        super().resume_writing()

    def _expect_request(self) -> None:
        _cancel(self._request)
        self._request = self.loop.call_later(self.bounds.request_seconds, self._end_unless_used)

    def _end_unless_used(self) -> None:
        """End the connection when no request came. A long answer that is being read is waited for; while a request is
        answered its end begins the time anew."""
        if self.flow.write_paused:
            self._expect_request()
        elif self.cycle is None or self.cycle.response_complete:
            self.transport.abort()

    def _is_one_too_many(self) -> bool:
        if self._connections_of_source() <= self.bounds.connections_of_source:
            return False
        address = ipaddress.ip_address(self._source())
        return not any(address in network for network in self.proxies)

    def _connections_of_source(self) -> int:
        own = (connection for connection in self.connections if isinstance(connection, BoundedConnection))
        return sum(one._source() == self._source() for one in own)

    def _log_refusals(self) -> None:
        """Log who was refused, once in a while, however many are."""
        kind = type(self)
        kind.refused += 1
        if self.loop.time() >= kind.logged_next:
            reason = f"it has {self.bounds.connections_of_source}; find out what keeps them open"
            log.warning("connections refused count=%d last_source=%s reason=%s", kind.refused, self._source(), reason)
            kind.refused = 0
            kind.logged_next = self.loop.time() + REFUSALS_LOGGED_SECONDS

    def _source(self) -> str:
        return self.client[0] if self.client else ""


def bounded_connections(bounds: WebBounds, proxies: Sequence[str]) -> type[BoundedConnection]:
    """The class of a server's connections; InputError when a proxy is no address or network."""
    try:
        networks = tuple(ipaddress.ip_network(proxy, strict=False) for proxy in proxies)
    except ValueError as error:
        raise InputError(f"proxies: {error}; give addresses or networks, such as 10.0.0.0/24") from error
    return type("Connection", (BoundedConnection,), {"bounds": bounds, "proxies": networks})


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
