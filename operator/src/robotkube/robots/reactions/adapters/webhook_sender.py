"""Deliveries as signed HTTP requests (port DeliverySender), on the standard library's client.

POST <url>
Content-Type: application/json
X-Hub-Signature-256: sha256=<hex>     HMAC-SHA256 of the body with the shared secret, as GitHub and the platform sign
X-Robotkube-Event: start | stop
X-Robotkube-Delivery: <id>            the same when a delivery is repeated
traceparent: 00-<trace>-<span>-01     W3C Trace Context
"""

from __future__ import annotations

import hashlib
import hmac
import http.client
import socket
from collections.abc import Callable
from contextlib import closing
from urllib.parse import urlsplit

from robotkube.errors import InputError, UnavailableError
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery

PASSING = frozenset([408, 425, 429])
ANSWER_BYTES_MAX = 64 * 1024


class WebhookSender:
    """A sender to one receiver. `secret` is read for every delivery, since it may be replaced; None: nothing is
    signed."""

    def __init__(self, url: str, secret: Callable[[], bytes] | None, timeout_seconds: float) -> None:
        self._parts = urlsplit(url)
        self._secret = secret
        self._timeout_seconds = timeout_seconds
        self._where = f"{self._parts.scheme}://{self._parts.netloc}"

    def probe(self) -> None:
        """See the port: the address accepts a connection."""
        port = self._parts.port or (443 if self._parts.scheme == "https" else 80)
        try:
            socket.create_connection((self._parts.hostname, port), self._timeout_seconds).close()
        except (OSError, ValueError) as error:  # a name that cannot be one is a ValueError
            raise UnavailableError(f"{self._where} does not answer: {error}") from error

    def send(self, delivery: EdgeDelivery) -> None:
        """See the port; a redirection is a refusal, for the signature is meant for one receiver."""
        headers = self._headers(delivery)
        path = (self._parts.path or "/") + (f"?{self._parts.query}" if self._parts.query else "")
        try:
            with closing(self._connection()) as connection:
                connection.request("POST", path, delivery.body, headers)
                answer = connection.getresponse()
                status = answer.status
                text = answer.read(ANSWER_BYTES_MAX)
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise UnavailableError(f"{self._where} does not answer: {error or type(error).__name__}") from error
        if 200 <= status < 300:
            return
        sentence = f"{self._where} answered {status}: {text[:200].decode(errors='replace').strip()}"
        raise (UnavailableError if status >= 500 or status in PASSING else InputError)(sentence)

    def close(self) -> None:
        """See the port: nothing is kept open."""

    def _headers(self, delivery: EdgeDelivery) -> dict[str, str]:
        headers = {
            "Content-Type": "application/json",
            "X-Robotkube-Event": delivery.edge,
            "X-Robotkube-Delivery": delivery.id,
            "traceparent": f"00-{delivery.trace}-{delivery.id[:16]}-01",
        }
        if self._secret is not None:
            signature = hmac.new(self._secret(), delivery.body, hashlib.sha256).hexdigest()
            headers["X-Hub-Signature-256"] = f"sha256={signature}"
        return headers

    def _connection(self) -> http.client.HTTPConnection:
        secure = self._parts.scheme == "https"
        make = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        return make(self._parts.netloc, timeout=self._timeout_seconds)
