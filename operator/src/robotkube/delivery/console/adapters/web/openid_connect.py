"""The provider of accounts, by OpenID Connect: its addresses, and who a code is of.

The person is read from the provider's userinfo, or from the ID token where the settings say so, over the connection on
which the token came; no token is kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import httpx

from robotkube.delivery.console.core.signing_in import (
    Person,
    Provider,
    SignIn,
    challenge,
    read_id_token,
    read_person,
    read_provider,
)
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.documents.core.patterns import WORD

TIMEOUT_SECONDS = 10.0
DISCOVERY = "/.well-known/openid-configuration"
NOT_REGISTERED = (
    "{} has no client id yet. The Job bootstrap registers the console at the forge and writes the id into ConfigMap "
    "console-sign-in; a kubelet brings it within two minutes. When it does not come, look at that Job."
)


class OpenIdConnect:
    """The provider that `settings` name; `client` makes the connection to it. `client_id_file` has the client's id
    where they do not: it is read at each sign-in, since it may come later, and be another one when the forge's data
    are."""

    def __init__(
        self,
        settings: SignIn,
        client: Callable[[], httpx.AsyncClient] | None = None,
        client_id_file: Path | None = None,
        now: Callable[[], float] = time.time,
    ) -> None:
        self._settings = settings
        self._client = client or _client
        self._client_id_file = client_id_file
        self._now = now
        self._provider: Provider | None = None

    def client_id(self) -> str:
        """The client's id at the provider; UnavailableError when there is none yet."""
        file = self._client_id_file
        if file is None:
            return self._settings.client_id
        try:
            text = file.read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError):
            text = ""
        if not WORD.fullmatch(text):
            raise UnavailableError(NOT_REGISTERED.format(file))
        return text

    async def provider(self) -> Provider:
        """Its addresses, asked for once; UnavailableError when it does not answer, or says nothing that helps."""
        if self._provider is None:
            url = f"{self._settings.issuer}{DISCOVERY}"
            async with self._client() as client:
                document = await _document(client, "GET", url)
            try:
                self._provider = read_provider(document, self._settings.issuer, self._settings.pages)
            except ValueError as error:
                raise UnavailableError(f"{url} {error}") from error
        return self._provider

    async def person(self, code: str, verifier: str) -> Person:
        """Who a code of the provider is of; InputError when it does not take the code."""
        provider = await self.provider()
        client_id = self.client_id()
        by_id_token = self._settings.by_id_token
        async with self._client() as client:
            form = self._form(code, verifier, client_id)
            tokens = await _document(client, "POST", provider.token, data=form)
            token = tokens.get("id_token" if by_id_token else "access_token")
            if not isinstance(token, str) or not token:
                raise InputError(f"{provider.token}: no {'id_token' if by_id_token else 'access_token'} in the answer")
            bearer = {"Authorization": f"Bearer {token}"}
            claims = None if by_id_token else await _document(client, "GET", provider.userinfo, headers=bearer)
        try:
            if claims is None:
                claims = read_id_token(token, self._settings.issuer, client_id, self._now())
            return read_person(claims, self._settings.username_claim, self._settings.groups_claim)
        except ValueError as error:
            raise InputError(f"{'the ID token' if by_id_token else provider.userinfo} {error}") from error

    def _form(self, code: str, verifier: str, client_id: str) -> dict[str, str]:
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": self._settings.redirect,
            "client_id": client_id,
            "code_verifier": verifier,
        }
        return {**form, "client_secret": self._settings.client_secret} if self._settings.client_secret else form


def authorization_url(provider: Provider, settings: SignIn, client_id: str, state: str, verifier: str) -> str:
    """The address to which a browser is sent to sign in."""
    query = {
        "response_type": "code",
        "client_id": client_id,
        "redirect_uri": settings.redirect,
        "scope": " ".join(settings.scopes),
        "state": state,
        "code_challenge": challenge(verifier),
        "code_challenge_method": "S256",
    }
    separator = "&" if urlsplit(provider.authorization).query else "?"
    return f"{provider.authorization}{separator}{urlencode(query)}"


def _client() -> httpx.AsyncClient:
    return httpx.AsyncClient(timeout=TIMEOUT_SECONDS, verify=certificate_authorities())


async def _document(client: httpx.AsyncClient, method: str, url: str, **arguments: Any) -> Mapping[str, Any]:
    try:
        headers = {"Accept": "application/json", **arguments.pop("headers", {})}
        answer = await client.request(method, url, headers=headers, **arguments)
    except httpx.HTTPError as error:
        raise UnavailableError(f"{method} {url}: {what_failed(error, url)}") from error
    if answer.status_code >= 500 or answer.status_code == 429:
        raise UnavailableError(f"{method} {url}: {answer.status_code}")
    if answer.is_error:
        raise InputError(f"{method} {url}: {answer.status_code} {answer.text[:200]}")
    try:
        document = answer.json()
    except ValueError as error:
        raise UnavailableError(f"{method} {url}: no JSON") from error
    if not isinstance(document, dict):
        raise UnavailableError(f"{method} {url}: no JSON object")
    return document
