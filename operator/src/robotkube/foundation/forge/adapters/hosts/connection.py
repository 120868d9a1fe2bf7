"""One HTTP connection to a forge's API, kept open; errors translated and chained."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.runtime.adapters.kept_connections import KeptConnections

TIMEOUT_SECONDS = 10.0


class ForgeConnection:
    """Calls below `url` with `headers` or `account` (name, password); `where` begins every error, `hint` says what to
    check when the forge refuses.

    UnavailableError: no answer, or an answer 5xx or 429, or a rate limit. InputError: any other refusal, which needs
    somebody to act."""

    def __init__(
        self,
        url: str,
        where: str,
        hint: str,
        headers: Mapping[str, str] | None = None,
        account: tuple[str, str] | None = None,
    ) -> None:
        self._url = url
        self._where = where
        self._hint = hint
        self._client = KeptConnections(
            base_url=url,
            auth=account,
            headers=dict(headers or {}),
            verify=certificate_authorities(),
            timeout=TIMEOUT_SECONDS,
            limits=httpx.Limits(max_connections=4, keepalive_expiry=60.0),
        )

    def disconnect(self) -> None:
        """Close the connections."""
        self._client.close()

    def call(self, method: str, path: str, **arguments: Any) -> Any:
        """The decoded answer; None when it is empty."""
        try:
            answer = self._client.request(method, path, **arguments)
        except httpx.HTTPError as error:
            raise UnavailableError(f"{self._where}: {method} {path}: {what_failed(error, self._url)}") from error
        if answer.status_code >= 500 or answer.status_code == 429 or _limited(answer):
            raise UnavailableError(f"{self._where}: {method} {path}: {answer.status_code} {_message(answer)}")
        if answer.is_error:
            raise InputError(f"{self._where}: {method} {path}: {answer.status_code} {_message(answer)}; {self._hint}")
        return answer.json() if answer.content else None


def _limited(answer: httpx.Response) -> bool:
    """Return whether GitHub refused for a rate limit: 403, with the number of calls left."""
    return answer.status_code == 403 and answer.headers.get("x-ratelimit-remaining") == "0"


def _message(answer: httpx.Response) -> str:
    try:
        body = answer.json()
    except ValueError:
        return answer.text[:200]
    return str(body.get("message", body) if isinstance(body, dict) else body)[:500]
