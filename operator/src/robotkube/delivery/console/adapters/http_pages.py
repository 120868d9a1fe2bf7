"""JSON pages of processes of the platform, over connections that are kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx

from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.runtime.adapters.certificate_authorities import certificate_authorities

TIMEOUT_SECONDS = 3.0
PAGE_BYTES_MAX = 32 * 1024 * 1024


class HttpPages:
    """The port Pages. For any thread."""

    def __init__(self) -> None:
        limits = httpx.Limits(max_connections=64, max_keepalive_connections=64, keepalive_expiry=30.0)
        self._client = httpx.Client(
            timeout=TIMEOUT_SECONDS, limits=limits, trust_env=False, verify=certificate_authorities(trust_env=False)
        )

    def get(self, url: str) -> Mapping[str, Any]:
        """See the port."""
        try:
            with self._client.stream("GET", url) as answer:
                data = _bounded(answer, url)
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

    def close(self) -> None:
        """Close the connections."""
        self._client.close()


def _bounded(answer: httpx.Response, url: str) -> bytes:
    parts, size = [], 0
    for part in answer.iter_bytes():
        size += len(part)
        if size > PAGE_BYTES_MAX:
            raise UnavailableError(f"{url}: more than {PAGE_BYTES_MAX} bytes")
        parts.append(part)
    return b"".join(parts)
