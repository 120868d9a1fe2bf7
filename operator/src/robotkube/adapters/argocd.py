"""Asking Argo CD to look again: the push hook of its ApplicationSet controller, and the refresh of an Application.

Both are best effort: they do not raise when nobody answers, they say whether they were heard, and log why not.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
from urllib.parse import quote

import httpx

HOOK_SECONDS_MAX = 5.0
REFRESH_SECONDS_MAX = 5.0

log = logging.getLogger(__name__)


class PushHook:
    """The push event in GitHub's shape, the only one the ApplicationSet controller takes from Gitea's side.

    `repository_url` must be the URL that the ApplicationSet names (without .git); the key is `webhook.github.secret`.
    """

    def __init__(self, url: str, secret: bytes, repository_url: str, branch: str = "main") -> None:
        self._url, self._secret, self._repository_url, self._branch = url, secret, repository_url, branch
        self._client = httpx.Client(timeout=HOOK_SECONDS_MAX)

    def disconnect(self) -> None:
        """Give the connection back."""
        self._client.close()

    def hook(self, before: str, after: str) -> bool:
        """Whether the controller took the event (HTTP 2xx)."""
        event = {
            "ref": f"refs/heads/{self._branch}",
            "before": before,
            "after": after,
            "repository": {"html_url": self._repository_url, "default_branch": self._branch},
        }
        body = json.dumps(event).encode()
        signature = "sha256=" + hmac.new(self._secret, body, hashlib.sha256).hexdigest()
        headers = {"Content-Type": "application/json", "X-GitHub-Event": "push", "X-Hub-Signature-256": signature}
        try:
            answer = self._client.post(self._url, content=body, headers=headers)
        except httpx.HTTPError as error:
            log.warning("hook not delivered url=%s after=%s reason=%s", self._url, after, error or type(error).__name__)
            return False
        if answer.is_error:
            reason = answer.text[:200].strip()
            log.warning("hook refused url=%s status=%d reason=%s", self._url, answer.status_code, reason)
        return answer.is_success


class ArgoCDServer:
    """The port ArgoCD: refreshes with an account that may only get Applications; hooks by a PushHook.

    The session's token (24 h) is asked for when first needed and again after a 401.
    """

    def __init__(self, url: str, username: str, password: str, push_hook: PushHook, project: str = "") -> None:
        self._client = httpx.Client(base_url=url, timeout=REFRESH_SECONDS_MAX)
        self._account = {"username": username, "password": password}
        self._push_hook, self._project = push_hook, project
        self._token = ""

    def disconnect(self) -> None:
        """Give the connections back, the hook's as well."""
        self._client.close()
        self._push_hook.disconnect()

    def hook(self, before: str, after: str) -> bool:
        """Send the push event of main to the ApplicationSet controller."""
        return self._push_hook.hook(before, after)

    def refresh(self, application: str) -> bool:
        """GET the Application with refresh=normal; False when it does not exist, is not allowed or nobody answers."""
        try:
            answer = self._get(application)
            if answer.status_code == 401:
                self._token = ""
                answer = self._get(application)
        except httpx.HTTPError as error:
            log.warning("refresh not heard application=%s reason=%s", application, error or type(error).__name__)
            return False
        if answer.is_error:
            log.warning("refresh refused application=%s status=%d", application, answer.status_code)
        return answer.is_success

    def _get(self, application: str) -> httpx.Response:
        if not self._token:
            self._log_in()
        query = {"refresh": "normal"} | ({"project": self._project} if self._project else {})
        path = f"/api/v1/applications/{quote(application, safe='')}"
        return self._client.get(path, params=query, headers={"Authorization": f"Bearer {self._token}"})

    def _log_in(self) -> None:
        answer = self._client.post("/api/v1/session", json=self._account)
        answer.raise_for_status()
        self._token = str(answer.json().get("token", ""))
