"""HTTP over connections that are kept (httpx), of which a server may end one just when it is used again or made, as the
forge does when it takes a renewed certificate: what loses nothing by it is asked again, on another connection."""

from __future__ import annotations

import ssl
from typing import Any

import httpx

from robotkube.foundation.runtime.adapters.asking_again import ask_again

READING = frozenset(["GET", "HEAD"])
ENDED_MEANWHILE = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError)


class KeptConnections(httpx.Client):
    """A client as httpx's own. What changes something is sent once: nobody knows whether it was heard, unless its
    connection ended before it was sent."""

    def send(self, request: httpx.Request, **options: Any) -> httpx.Response:
        """The answer to a request."""
        send = super().send
        return ask_again(lambda: send(request, **options), lambda error: _lost_nothing(request, error))


def _lost_nothing(request: httpx.Request, error: Exception) -> bool:
    """Return whether the server's end just then lost nothing. Who refuses connections, or cannot be reached, is
    away."""
    if isinstance(error, httpx.ConnectError):
        return _ended_by_the_other_side(error)
    return isinstance(error, ENDED_MEANWHILE) and request.method in READING


def _ended_by_the_other_side(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, ConnectionResetError | ssl.SSLEOFError | ssl.SSLZeroReturnError):
            return True
        error = error.__cause__ or error.__context__
    return False
