"""Who a client of an OCI registry is: nobody until the registry asks, then its account or a token.

The forge takes the account itself. Others (ghcr.io, GitLab, distribution with `auth.token`) name a place that gives
tokens, each for a scope and some minutes (https://distribution.github.io/distribution/spec/auth/token/).
"""

from __future__ import annotations

import base64
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.charts.core.challenges import BASIC, Challenge, chosen, read_challenges, scope_of

TOKEN_BYTES_MAX = 1 << 20
TOKEN_SECONDS = 60.0  # of one that does not say how long it is good for
MARGIN_SECONDS = 10.0  # before its end a token is not used any more: what it begins has to end
HEADER = "Authorization"


@dataclass(frozen=True)
class _Token:
    text: str
    ends: float


class RegistryAuthentication:
    """Authorises the requests of one client to one registry, and to no other host. Several threads may use it."""

    def __init__(
        self, client: httpx.Client, user: str, password: str, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._client = client
        self._account = f"Basic {base64.b64encode(f'{user}:{password}'.encode()).decode()}" if user else ""
        self._user = user
        self._monotonic = monotonic
        self._asked: Challenge | None = None
        self._tokens: dict[str, _Token] = {}  # scope -> the token for it

    def authorise(self, request: httpx.Request) -> None:
        """Add what the registry asked for earlier; a token that ends is replaced before."""
        if self._asked is None or not self._is_registry(request):
            return
        if self._asked.scheme == BASIC:
            request.headers[HEADER] = self._account
            return
        scope = scope_of(request.method, request.url.path)
        token = self._tokens.get(scope)
        if token is not None and token.ends - MARGIN_SECONDS <= self._monotonic():
            token = self._fetch(self._asked, scope, scope)
        if token is not None:
            request.headers[HEADER] = f"Bearer {token.text}"

    def learn(self, request: httpx.Request, answer: httpx.Response) -> bool:
        """Return whether the same request may be answered now, after the registry refused it: true once it had said
        what it wants, and that was not what the request had."""
        challenge = chosen(read_challenges(answer.headers.get_list("WWW-Authenticate")), bool(self._account))
        if challenge is None or not self._is_registry(request):
            return False
        self._asked = challenge
        if challenge.scheme == BASIC:
            shown: str | None = request.headers.get(HEADER)
            return shown != self._account
        scope = scope_of(request.method, request.url.path)
        self._fetch(challenge, scope, challenge.parameters.get("scope") or scope)
        return True

    def _is_registry(self, request: httpx.Request) -> bool:
        base = self._client.base_url
        return (request.url.scheme, request.url.netloc) == (base.scheme, base.netloc)

    def _fetch(self, challenge: Challenge, scope: str, wanted: str) -> _Token:
        """A token for the scopes in `wanted`, kept for requests of `scope`."""
        realm = self._realm(challenge)
        question: dict[str, str | list[str]] = {"scope": wanted.split()}
        question |= {"service": challenge.parameters["service"]} if "service" in challenge.parameters else {}
        headers = {HEADER: self._account} if self._account else {}
        document = self._ask(realm.copy_merge_params(question), headers)
        text = document.get("token") or document.get("access_token")
        if not isinstance(text, str) or not text.isascii() or not text.isprintable():
            raise InputError(f"{realm}: its answer has no token; ask who runs the registry")
        seconds = document.get("expires_in")
        lasts = float(seconds) if isinstance(seconds, (int, float)) and seconds > 0 else TOKEN_SECONDS
        token = _Token(text, self._monotonic() + max(lasts, MARGIN_SECONDS))
        self._tokens[scope] = token
        return token

    def _realm(self, challenge: Challenge) -> httpx.URL:
        """The place that gives tokens: the account is shown to it, so not in clear text where the registry is not."""
        text = challenge.parameters.get("realm", "")
        try:
            realm = httpx.URL(text)
        except httpx.InvalidURL:
            realm = httpx.URL("")
        schemes = ("https",) if self._client.base_url.scheme == "https" else ("http", "https")
        if realm.scheme not in schemes or not realm.host:
            raise InputError(
                f"OCI registry {self._client.base_url.host}: wants a token of {text[:200]!r}, which is no address of "
                f"{' or '.join(schemes)}; nothing is shown to it"
            )
        return realm

    def _ask(self, url: httpx.URL, headers: dict[str, str]) -> dict[str, Any]:
        where = f"{url.copy_with(query=None)}"
        try:
            with self._client.stream("GET", url, headers=headers, follow_redirects=False) as answer:
                data = _bounded(answer, where)
        except httpx.HTTPError as error:
            raise UnavailableError(
                f"{where}: gives tokens of the OCI registry: {error or type(error).__name__}"
            ) from error
        if answer.status_code >= httpx.codes.INTERNAL_SERVER_ERROR:
            raise UnavailableError(f"{where}: gives tokens of the OCI registry, answered {answer.status_code}")
        if answer.status_code != httpx.codes.OK:
            raise InputError(
                f"OCI registry {self._client.base_url.host}: account {self._user or '(none)'} may not do this: "
                f"{where} gives it no token ({answer.status_code}); check account and team"
            )
        try:
            document = read_json(data)
        except ValueError:
            document = None
        return document if isinstance(document, dict) else {}


def _bounded(answer: httpx.Response, where: str) -> bytes:
    data = bytearray()
    for piece in answer.iter_bytes():
        data += piece
        if len(data) > TOKEN_BYTES_MAX:
            raise InputError(f"{where}: its answer is longer than {TOKEN_BYTES_MAX} bytes; it is not read")
    return bytes(data)
