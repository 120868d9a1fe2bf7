"""Sessions of people who signed in, and sign-ins that are under way. Both are kept in memory: after a restart everybody
signs in again, which goes by itself as long as the provider knows him."""

from __future__ import annotations

import hmac
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from robotkube.delivery.console.core.signing_in import Person

SESSION_SECONDS = 12 * 3600.0
SIGNING_IN_SECONDS = 600.0
SESSIONS_MAX = 10_000

T = TypeVar("T")


@dataclass(frozen=True)
class Session:
    """A person's session; `csrf` is the word that a request which changes something has to name."""

    person: Person
    csrf: str

    def vouches(self, word: str) -> bool:
        """Return whether a request names the session's word."""
        return hmac.compare_digest(word.encode(), self.csrf.encode())


@dataclass(frozen=True)
class SigningIn:
    """A sign-in under way: what the provider hands back, the verifier, and where the person wanted to go."""

    state: str
    verifier: str
    back: str


class _Kept(Generic[T]):
    """Values by random keys, each for a time; of too many the oldest goes."""

    def __init__(self, seconds: float, monotonic: Callable[[], float], word: Callable[[], str]) -> None:
        self._seconds = seconds
        self._monotonic = monotonic
        self._word = word
        self._values: OrderedDict[str, tuple[float, T]] = OrderedDict()

    def keep(self, value: T) -> str:
        """Keep a value, and return its key."""
        key = self._word()
        self._values[key] = (self._monotonic() + self._seconds, value)
        while len(self._values) > SESSIONS_MAX:
            self._values.popitem(last=False)
        return key

    def get(self, key: str) -> T | None:
        """The value; None when there is none (any more)."""
        until, value = self._values.get(key, (0.0, None))
        if value is not None and self._monotonic() >= until:
            self.drop(key)
            return None
        return value

    def drop(self, key: str) -> None:
        """Forget a value."""
        self._values.pop(key, None)


class Sessions:
    """Both kinds. `word` draws a random word that nobody guesses. For one thread."""

    def __init__(self, monotonic: Callable[[], float], word: Callable[[], str]) -> None:
        self._word = word
        self._sessions: _Kept[Session] = _Kept(SESSION_SECONDS, monotonic, word)
        self._begun: _Kept[SigningIn] = _Kept(SIGNING_IN_SECONDS, monotonic, word)

    def begin(self, back: str) -> tuple[str, SigningIn]:
        """A new sign-in, and its key for the browser's cookie."""
        begun = SigningIn(self._word(), self._word(), back)
        return self._begun.keep(begun), begun

    def finish(self, key: str, state: str) -> SigningIn | None:
        """The sign-in of this cookie, once; None when there is none, or the provider answers another one."""
        begun = self._begun.get(key)
        self._begun.drop(key)
        return begun if begun is not None and hmac.compare_digest(begun.state.encode(), state.encode()) else None

    def open(self, person: Person) -> str:
        """A session, by its key for the browser's cookie."""
        return self._sessions.keep(Session(person, self._word()))

    def get(self, key: str) -> Session | None:
        """The session of this cookie; None when there is none (any more)."""
        return self._sessions.get(key)

    def close(self, key: str) -> None:
        """End a session."""
        self._sessions.drop(key)
