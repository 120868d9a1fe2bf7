"""The life of a certificate: from when on it is replaced, and for what reasons it is replaced at once. Times in seconds
since 1970."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

EARLY_SECONDS_MAX = 300.0
EARLY_SHARE = 0.01


@dataclass(frozen=True)
class Pair:
    """A certificate and its private key, both as PEM; the key is in no representation."""

    certificate: str
    key: str = field(repr=False)


@dataclass(frozen=True)
class Issued:
    """A certificate with its key, and the certificate of the authority that signed it."""

    authority: str
    pair: Pair


@dataclass(frozen=True)
class Life:
    """What a certificate says: the names it is for, its first and last moment, its number, and whether the key beside
    it is its own and the authority that is asked about signed it."""

    names: frozenset[str]
    begin: float
    end: float
    has_key: bool
    signed: bool
    serial: int = 0

    @property
    def renewal(self) -> float:
        """The moment from which on it is replaced: at two thirds of its life."""
        return self.end - (self.end - self.begin) / 3


def begin_before(now: float, seconds: float) -> float:
    """The first moment of a certificate that is made now: a little earlier, since clocks differ."""
    return now - min(EARLY_SECONDS_MAX, EARLY_SHARE * seconds)


def reason_to_replace(life: Life | None, names: Collection[str], now: float) -> str:
    """The reason why a certificate is replaced now, in words; empty while it stays. None: there is none."""
    if life is None:
        return "there is none"
    if not life.has_key:
        return "its key is another one"
    if not life.signed:
        return "another authority signed it"
    if life.names != frozenset(names):
        return "its names changed"
    if now >= life.renewal:
        return "two thirds of its life are over" if now < life.end else "it has expired"
    return "it is not valid yet" if now < life.begin else ""
