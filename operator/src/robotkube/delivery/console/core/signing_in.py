"""Signing in by OpenID Connect: what is asked of the provider, and who of its users may read (RFC 6749, RFC 7636)."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SignIn:
    """How people sign in: the provider, the client there (a secret where it has one), and the groups whose members may
    read. `url` is the console's own address in a browser; `scopes` are what is asked for."""

    issuer: str
    client_id: str
    client_secret: str
    url: str
    groups: frozenset[str]
    username_claim: str
    groups_claim: str
    scopes: tuple[str, ...]

    @property
    def redirect(self) -> str:
        """Where the provider sends a browser back to."""
        return f"{self.url}/auth/callback"

    @property
    def encrypted(self) -> bool:
        """Return whether a browser speaks TLS with the console."""
        return self.url.startswith("https://")


@dataclass(frozen=True)
class Provider:
    """The provider's addresses, as its discovery document names them."""

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


def read_provider(document: Mapping[str, Any], issuer: str) -> Provider:
    """The addresses in a discovery document; ValueError says what is wrong with it."""
    if str(document.get("issuer", "")).rstrip("/") != issuer.rstrip("/"):
        raise ValueError(
            f"names the issuer {document.get('issuer')!r} instead of {issuer}; give it as the provider does"
        )
    names = ("authorization_endpoint", "token_endpoint", "userinfo_endpoint")
    addresses = [document.get(name) for name in names]
    wrong = [n for n, a in zip(names, addresses, strict=True) if not str(a).startswith(("http://", "https://"))]
    if wrong:
        raise ValueError(f"has no {', '.join(wrong)}")
    return Provider(*map(str, addresses))


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
