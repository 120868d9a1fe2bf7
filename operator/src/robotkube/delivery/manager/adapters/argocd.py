"""Requests to Argo CD to read Git again: a push hook for its ApplicationSet controller, the refresh of an Application.

Both are best effort: they do not raise when nobody answers, they return whether they were received, and log why not.
"""

from __future__ import annotations

import logging
from urllib.parse import quote

import httpx

from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities
from robotkube.foundation.forge.ports.pull_requests import PushHook

REFRESH_SECONDS_MAX = 5.0

log = logging.getLogger(__name__)


class ArgoCDServer:
    """The port ArgoCD: refreshes with an account that may only get Applications; hooks by a PushHook.

    It requests the session's token (24 h) when one is first needed and again after a 401.
    """

    def __init__(self, url: str, username: str, password: str, push_hook: PushHook, project: str = "") -> None:
        self._client = httpx.Client(base_url=url, verify=certificate_authorities(), timeout=REFRESH_SECONDS_MAX)
        self._account = {"username": username, "password": password}
        self._push_hook = push_hook
        self._project = project
        self._token = ""

    def disconnect(self) -> None:
        """Close the connections; the hook belongs to whoever made it."""
        self._client.close()

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
            log.warning("refresh not received application=%s reason=%s", application, error or type(error).__name__)
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
