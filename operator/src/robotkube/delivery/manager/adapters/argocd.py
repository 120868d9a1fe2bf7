"""Requests to Argo CD to read Git again: a push hook for its ApplicationSet controller, the refresh of an Application.

Both are best effort: they do not raise when nobody answers, they return whether they were received, and log why not.
"""

from __future__ import annotations

import logging
import ssl
from pathlib import Path
from urllib.parse import quote

import httpx

from robotkube.errors import InputError
from robotkube.foundation.certificates.adapters.certificate_authorities import (
    certificate_authorities,
    refused_handshake,
)
from robotkube.foundation.certificates.adapters.verification import PLAIN_ANSWERS
from robotkube.foundation.forge.ports.pull_requests import PushHook

REFRESH_SECONDS_MAX = 5.0
TO_TRUST = (
    "give the chart its certificate in argocd.server.authorities, or let it answer in clear text "
    '(server.insecure: "true" in ConfigMap argocd-cmd-params-cm of Argo CD)'
)
ELSEWHERE = "name the address that answers in argocd.server.url of the chart, with the path of server.rootpath"

log = logging.getLogger(__name__)


class _Redirected(httpx.HTTPError):
    """An answer that names another address, which is not asked: the account's password would go there."""


class _Stranger(httpx.HTTPError):
    """An answer that is none of Argo CD's API."""


class ArgoCDServer:
    """The port ArgoCD: refreshes with an account that may only get Applications; hooks by a PushHook.

    It requests the session's token (24 h) when one is first needed and again after a 401. `authorities`: a file (PEM)
    with who signed the server's certificate, or with that certificate itself; without it the usual ones count.
    InputError when the file has none.
    """

    def __init__(
        self,
        url: str,
        username: str,
        password: str,
        push_hook: PushHook,
        project: str = "",
        authorities: Path | None = None,
    ) -> None:
        self._url = url
        self._client = httpx.Client(base_url=url, verify=_trusting(authorities), timeout=REFRESH_SECONDS_MAX)
        self._account = {"username": username, "password": password}
        self._push_hook = push_hook
        self._project = project
        self._token = ""
        self._redirected = False

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
        except _Redirected as redirect:
            self._say_redirected(str(redirect))
            return False
        except httpx.HTTPError as error:
            log.warning("refresh not received application=%s reason=%s", application, _what_failed(error))
            return False
        self._redirected = False
        if answer.is_error:
            log.warning("refresh refused application=%s status=%d", application, answer.status_code)
        return answer.is_success

    def _say_redirected(self, address: str) -> None:
        """Log it once, until the server has answered: every request meets the same."""
        if self._redirected:
            return
        self._redirected = True
        encrypted = address.startswith("https://") and not self._url.startswith("https://")
        log.error("refresh redirected url=%s to=%s fix=%s", self._url, address, TO_TRUST if encrypted else ELSEWHERE)

    def _get(self, application: str) -> httpx.Response:
        if not self._token:
            self._log_in()
        query = {"refresh": "normal"} | ({"project": self._project} if self._project else {})
        path = f"/api/v1/applications/{quote(application, safe='')}"
        return _answered(self._client.get(path, params=query, headers={"Authorization": f"Bearer {self._token}"}))

    def _log_in(self) -> None:
        answer = _answered(self._client.post("/api/v1/session", json=self._account))
        answer.raise_for_status()
        self._token = _token_in(answer)


def _token_in(answer: httpx.Response) -> str:
    try:
        document = answer.json()
    except ValueError:
        document = None
    token = document.get("token") if isinstance(document, dict) else None
    if not token:
        raise _Stranger(f"{answer.url} answers without a token, so it is not argocd-server; {ELSEWHERE}")
    return str(token)


def _answered(answer: httpx.Response) -> httpx.Response:
    if answer.has_redirect_location:
        raise _Redirected(answer.headers["location"])
    return answer


def _trusting(authorities: Path | None) -> ssl.SSLContext:
    """Whom the client believes. What the file names is believed by itself: Argo CD signs its own certificate, which is
    no authority's, and one that somebody gave it may stand there without who signed it."""
    if authorities is None:
        return certificate_authorities()
    try:
        context = certificate_authorities(more=authorities)
    except InputError as error:
        raise InputError(
            f"argocd.authorities: {authorities} has no certificate that can be read (PEM); the chart writes "
            "argocd.server.authorities there"
        ) from error
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def _what_failed(error: httpx.HTTPError) -> str:
    """What an attempt met, in words: of a refused handshake what to do."""
    refused = refused_handshake(error)
    if isinstance(refused, ssl.SSLCertVerificationError):
        return (
            f"argocd-server's certificate does not hold ({refused.verify_message}): argocd.server.authorities of the "
            "chart has to have it, or who signed it, and argocd.server.url a name that stands in it"
        )
    if refused is not None and refused.reason in PLAIN_ANSWERS:
        return (
            "argocd-server speaks no TLS there: leave argocd.server of the chart empty, or begin argocd.server.url "
            "with http://"
        )
    return str(error) or type(error).__name__
