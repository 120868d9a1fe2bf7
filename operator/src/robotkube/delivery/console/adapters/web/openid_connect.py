"""The provider of accounts, by OpenID Connect: its addresses, and who a code is of.

The person is read from the provider's userinfo, over the connection that the token came by; no token is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlencode, urlsplit

import httpx

from robotkube.delivery.console.core.signing_in import Person, Provider, SignIn, challenge, read_person, read_provider
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed

TIMEOUT_SECONDS = 10.0
DISCOVERY = "/.well-known/openid-configuration"


class OpenIdConnect:
    """The provider that `settings` name; `client` makes the connection to it."""

    def __init__(self, settings: SignIn, client: Callable[[], httpx.AsyncClient] | None = None) -> None:
        self._settings = settings
        self._client = client or _client
        self._provider: Provider | None = None

    async def provider(self) -> Provider:
        """Its addresses, asked for once; UnavailableError when it does not answer, or says nothing that helps."""
        if self._provider is None:
            url = f"{self._settings.issuer}{DISCOVERY}"
            async with self._client() as client:
                document = await _document(client, "GET", url)
            try:
                self._provider = read_provider(document, self._settings.issuer)
            except ValueError as error:
                raise UnavailableError(f"{url} {error}") from error
        return self._provider

    async def person(self, code: str, verifier: str) -> Person:
        """Who a code of the provider is of; InputError when it does not take the code."""
        provider = await self.provider()
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": self._settings.redirect,
            "client_id": self._settings.client_id,
            "code_verifier": verifier,
        }
        if self._settings.client_secret:
            form["client_secret"] = self._settings.client_secret
        async with self._client() as client:
            token = await _document(client, "POST", provider.token, data=form)
            access = token.get("access_token")
            if not isinstance(access, str) or not access:
                raise InputError(f"{provider.token}: no access_token in the answer")
            claims = await _document(client, "GET", provider.userinfo, headers={"Authorization": f"Bearer {access}"})
        try:
            return read_person(claims, self._settings.username_claim, self._settings.groups_claim)
        except ValueError as error:
            raise InputError(f"{provider.userinfo} {error}") from error


def authorization_url(provider: Provider, settings: SignIn, state: str, verifier: str) -> str:
    """Where a browser is sent to sign in."""
    query = {
        "response_type": "code",
        "client_id": settings.client_id,
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
