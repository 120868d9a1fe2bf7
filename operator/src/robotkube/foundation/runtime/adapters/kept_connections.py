"""HTTP over connections that are kept (httpx), of which a server may end one just when it is used again, as the forge
does when it takes a renewed certificate: what only reads is asked once more, on another connection."""

from __future__ import annotations

from typing import Any

import httpx

READING = frozenset(["GET", "HEAD"])


class KeptConnections(httpx.Client):
    """A client as httpx's own. A request that changes something is sent once: nobody knows whether it was heard."""

    def send(self, request: httpx.Request, **options: Any) -> httpx.Response:
        """The answer to a request."""
        try:
            return super().send(request, **options)
        except (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError):
            if request.method not in READING:
                raise
            return super().send(request, **options)
