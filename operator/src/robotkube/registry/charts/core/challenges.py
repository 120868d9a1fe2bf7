"""What a registry asks of a client that it does not know yet: the header WWW-Authenticate (RFC 9110), and the scope of
a token that a request needs (distribution's token specification)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

BASIC, BEARER = "basic", "bearer"
HEADER_CHARACTERS_MAX = 8192
_SCHEME = re.compile(r"[\s,]*([A-Za-z][A-Za-z0-9-]*)(?=\s|,|$)")
_PARAMETER = re.compile(r'[\s,]*([A-Za-z0-9_-]+)\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^\s,"]+))')
_NAMED = re.compile(r"/v2/(.+)/(?:manifests|blobs|tags|referrers)/")
_ACTIONS = {"GET": "pull", "HEAD": "pull", "DELETE": "delete"}


@dataclass(frozen=True)
class Challenge:
    """One way to say who one is: `scheme` in lower case, and its parameters, such as realm, service and scope."""

    scheme: str
    parameters: Mapping[str, str] = field(default_factory=dict)


def read_challenges(headers: Sequence[str]) -> list[Challenge]:
    """All challenges of these headers, in their order; what is not readable ends its header."""
    return [challenge for header in headers for challenge in _of_one(header[:HEADER_CHARACTERS_MAX])]


def _of_one(header: str) -> list[Challenge]:
    challenges: list[tuple[str, dict[str, str]]] = []
    place = 0
    while place < len(header):
        parameter = _PARAMETER.match(header, place)
        scheme = None if parameter else _SCHEME.match(header, place)
        if parameter and challenges:
            name, quoted, plain = parameter.groups()
            challenges[-1][1][name.lower()] = plain if quoted is None else re.sub(r"\\(.)", r"\1", quoted)
        elif scheme:
            challenges.append((scheme[1].lower(), {}))
        else:
            break
        place = (parameter or scheme).end()  # type: ignore[union-attr]
    return [Challenge(name, parameters) for name, parameters in challenges]


def chosen(challenges: Sequence[Challenge], has_account: bool) -> Challenge | None:
    """The challenge to answer: the account itself where that is offered, else a token; None when it is neither."""
    wanted = (BASIC, BEARER) if has_account else (BEARER,)
    return next((challenge for scheme in wanted for challenge in challenges if challenge.scheme == scheme), None)


def scope_of(method: str, path: str) -> str:
    """The scope that a request needs, as registries name it; empty where it is about no repository."""
    named = _NAMED.search(path)
    return f"repository:{named[1]}:{_ACTIONS.get(method, 'pull,push')}" if named else ""
