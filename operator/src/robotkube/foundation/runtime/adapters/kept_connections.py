"""HTTP over connections that are kept (httpx), of which a server may end one just when it is used again or made, as the
forge does when it takes a renewed certificate: what loses nothing by it is asked again, on another connection."""

from __future__ import annotations

import random
import ssl
import time
from typing import Any

import httpx

from robotkube.backoffs import backoff

READING = frozenset(["GET", "HEAD"])
ATTEMPTS_MAX = 3  # the kept connection; a new one that the ending server took yet; the next server's
PAUSE_SECONDS_FIRST, PAUSE_SECONDS_MAX = 0.1, 0.2  # between attempts: the port passes to the next server meanwhile
ENDED_MEANWHILE = (httpx.ConnectError, httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError)


class KeptConnections(httpx.Client):
    """A client as httpx's own. What changes something is sent once: nobody knows whether it was heard, unless its
    connection ended before it was sent."""

    def send(self, request: httpx.Request, **options: Any) -> httpx.Response:
        """The answer to a request, of at most ATTEMPTS_MAX attempts."""
        for attempt in range(ATTEMPTS_MAX - 1):
            try:
                return super().send(request, **options)
            except ENDED_MEANWHILE as error:
                if not _may_be_sent_again(request, error):
                    raise
            time.sleep(backoff(attempt, PAUSE_SECONDS_FIRST, PAUSE_SECONDS_MAX, random.random))
        return super().send(request, **options)


def _may_be_sent_again(request: httpx.Request, error: httpx.TransportError) -> bool:
    """Whether an end just then lost nothing. Who refuses connections, or cannot be reached, is away."""
    if isinstance(error, httpx.ConnectError):
        return _ended_by_the_other_side(error)
    return request.method in READING


def _ended_by_the_other_side(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, ConnectionResetError | ssl.SSLEOFError | ssl.SSLZeroReturnError):
            return True
        error = error.__cause__ or error.__context__
    return False
