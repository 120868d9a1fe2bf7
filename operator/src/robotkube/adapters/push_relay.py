"""Telling a manager that main moved, in the form of the forge's own deliveries.

The forge tells it too, about a fifth of a second after the push: it computes its own records first. Best effort: a
manager that is not there hears it from the forge, or looks by itself.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging

import httpx

RELAY_SECONDS_MAX = 1.0

log = logging.getLogger(__name__)


class PushRelay:
    """The port PushHook for one manager's webhook; `repository` is `<organisation>/<name>`, `secret` the one that the
    manager shares with the forge."""

    def __init__(self, url: str, secret: bytes, repository: str, branch: str = "main") -> None:
        self._url, self._secret, self._repository, self._branch = url, secret, repository, branch
        self._client = httpx.Client(timeout=RELAY_SECONDS_MAX)

    def disconnect(self) -> None:
        """Give the connection back."""
        self._client.close()

    def hook(self, before: str, after: str) -> bool:
        """Whether the manager took the event (HTTP 2xx)."""
        event = {
            "ref": f"refs/heads/{self._branch}",
            "before": before,
            "after": after,
            "repository": {"full_name": self._repository},
        }
        body = json.dumps(event).encode()
        signature = hmac.new(self._secret, body, hashlib.sha256).hexdigest()
        headers = {"Content-Type": "application/json", "X-Gitea-Event": "push", "X-Gitea-Signature": signature}
        try:
            answer = self._client.post(self._url, content=body, headers=headers)
        except httpx.HTTPError as error:
            log.warning("push not told url=%s after=%s reason=%s", self._url, after, error or type(error).__name__)
            return False
        if answer.is_error:
            log.warning("push not taken url=%s status=%d", self._url, answer.status_code)
        return answer.is_success
