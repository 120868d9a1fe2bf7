"""JSON pages of processes of the platform, over connections that are kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import httpx

from robotkube.errors import UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities
from robotkube.foundation.documents.core.json_codec import read_json

TIMEOUT_SECONDS = 3.0  # until something comes, and then until more does
PAGE_SECONDS_MAX = 6.0
PAGE_BYTES_MAX = 32 * 1024 * 1024
AGENT_PAGE_BYTES_MAX = 8 * 1024 * 1024  # of 1,000 edges; whoever has an agent answers what he likes


class HttpPages:
    """The port Pages, of at most `bytes_max` each. For any thread."""

    def __init__(self, bytes_max: int = PAGE_BYTES_MAX, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._bytes_max = bytes_max
        self._monotonic = monotonic
        limits = httpx.Limits(max_connections=64, max_keepalive_connections=64, keepalive_expiry=30.0)
        self._client = httpx.Client(
            timeout=TIMEOUT_SECONDS, limits=limits, trust_env=False, verify=certificate_authorities(trust_env=False)
        )

    def get(self, url: str) -> Mapping[str, Any]:
        """See the port."""
        try:
            with self._client.stream("GET", url) as answer:
                data = self._bounded(answer, url)
        except httpx.HTTPError as error:
            raise UnavailableError(f"{url}: {error or type(error).__name__}") from error
        if answer.status_code != 200:
            raise UnavailableError(f"{url}: {answer.status_code}")
        try:
            document = read_json(data)
        except ValueError as error:
            raise UnavailableError(f"{url}: no JSON: {str(error)[:200]}") from error
        if not isinstance(document, dict):
            raise UnavailableError(f"{url}: no JSON object")
        return document

    def _bounded(self, answer: httpx.Response, url: str) -> bytes:
        """The whole answer: who sends a little at a time keeps nobody waiting, who sends without end fills nothing."""
        end = self._monotonic() + PAGE_SECONDS_MAX
        parts, size = [], 0
        for part in answer.iter_bytes():
            size += len(part)
            if size > self._bytes_max:
                raise UnavailableError(f"{url}: more than {self._bytes_max} bytes")
            if self._monotonic() >= end:
                raise UnavailableError(f"{url}: no end within {PAGE_SECONDS_MAX:.0f} s")
            parts.append(part)
        return b"".join(parts)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()
