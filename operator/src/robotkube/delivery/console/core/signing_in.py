"""Signing in by OpenID Connect: what is asked of the provider, and who of its users may read (RFC 6749, RFC 7636)."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

LEEWAY_SECONDS = 300.0
"""How far the clocks of provider and console may be apart."""


@dataclass(frozen=True)
class SignIn:
    """How people sign in: the provider, the client there (a secret where it has one), and the groups whose members may
    read. `url` is the console's own address in a browser; `scopes` are what is asked for. `client_id` is empty where a
    file has it, which may come later. `pages` is where browsers reach the provider, where that is not `issuer`.
    `by_id_token`: who somebody is stands in the ID token, and the access token is not used."""

    issuer: str
    client_id: str
    client_secret: str
    url: str
    groups: frozenset[str]
    username_claim: str
    groups_claim: str
    scopes: tuple[str, ...]
    pages: str = ""
    by_id_token: bool = False

    @property
    def redirect(self) -> str:
        """The address to which the provider sends a browser back."""
        return f"{self.url}/auth/callback"

    @property
    def encrypted(self) -> bool:
        """Return whether a browser speaks TLS with the console."""
        return self.url.startswith("https://")


@dataclass(frozen=True)
class Provider:
    """The provider's addresses, as its discovery document names them; `authorization` as browsers reach it."""

    authorization: str
    token: str
    userinfo: str


@dataclass(frozen=True)
class Person:
    """Who signed in: the name, and the groups that the provider says he is in."""

    name: str
    groups: tuple[str, ...] = ()

    def is_in(self, listed: Collection[str]) -> bool:
        """Return whether one of the groups is listed."""
        return any(group in listed for group in self.groups)


def read_provider(document: Mapping[str, Any], issuer: str, pages: str = "") -> Provider:
    """The addresses in a discovery document; ValueError says what is wrong with it. With `pages` browsers are sent
    there instead of to the issuer: to the same path."""
    if str(document.get("issuer", "")).rstrip("/") != issuer.rstrip("/"):
        raise ValueError(
            f"names the issuer {document.get('issuer')!r} instead of {issuer}; give it as the provider does"
        )
    names = ("authorization_endpoint", "token_endpoint", "userinfo_endpoint")
    addresses = [document.get(name) for name in names]
    wrong = [n for n, a in zip(names, addresses, strict=True) if not str(a).startswith(("http://", "https://"))]
    if wrong:
        raise ValueError(f"has no {', '.join(wrong)}")
    authorization, token, userinfo = map(str, addresses)
    return Provider(_in_browsers(authorization, issuer.rstrip("/"), pages) if pages else authorization, token, userinfo)


def _in_browsers(authorization: str, issuer: str, pages: str) -> str:
    if not authorization.startswith(f"{issuer}/"):
        raise ValueError(
            f"has its authorization_endpoint at {authorization}, which is not below {issuer}: nobody knows how "
            f"browsers reach it at {pages}"
        )
    return pages + authorization.removeprefix(issuer)


def read_id_token(token: str, issuer: str, client_id: str, now: float) -> Mapping[str, Any]:
    """The claims of an ID token; ValueError says what is wrong with it.

    It came from the provider's token endpoint, for a code of this console's own, on a connection on which the provider
    proved who it is. That stands in the place of its signature (OpenID Connect Core 1.0, 3.1.3.7, 6).
    """
    claims = _payload(token)
    if str(claims.get("iss", "")).rstrip("/") != issuer.rstrip("/"):
        raise ValueError(f"is of the issuer {claims.get('iss')!r} instead of {issuer}")
    if claims.get("aud") not in (client_id, [client_id]):
        raise ValueError(f"is for {claims.get('aud')!r} instead of the client {client_id} alone")
    ends = claims.get("exp")
    if not isinstance(ends, int | float) or not now < ends + LEEWAY_SECONDS:
        raise ValueError(f"ended at {ends!r}, and it is {now:.0f}; compare the clocks of provider and console")
    return claims


def _payload(token: str) -> Mapping[str, Any]:
    parts = token.split(".")
    try:
        text = base64.b64decode(parts[1] + "=" * (-len(parts[1]) % 4), b"-_", validate=True)
        document = json.loads(text)
    except (IndexError, ValueError, RecursionError) as error:
        raise ValueError("is no JSON Web Token") from error
    if len(parts) != 3 or not isinstance(document, dict):
        raise ValueError("is no JSON Web Token")
    return document


def challenge(verifier: str) -> str:
    """The challenge of a verifier, by the method S256."""
    return base64.urlsafe_b64encode(hashlib.sha256(verifier.encode()).digest()).rstrip(b"=").decode()


def read_person(claims: Mapping[str, Any], username_claim: str, groups_claim: str) -> Person:
    """Who the claims are of; ValueError when they name nobody."""
    name = claims.get(username_claim)
    if not isinstance(name, str) or not name:
        raise ValueError(f"has no claim {username_claim}; name another one in sign_in.username_claim")
    groups = claims.get(groups_claim)
    listed: Sequence[Any] = groups if isinstance(groups, list) else []
    return Person(name, tuple(group for group in listed if isinstance(group, str)))


def place_to_return(path: str) -> str:
    """A path of the console itself to come back to: `/` instead of anything that a browser would take for another
    host."""
    plain = path.startswith("/") and not path.startswith("//") and "\\" not in path and path.isprintable()
    return path if plain and len(path) <= 1000 else "/"
