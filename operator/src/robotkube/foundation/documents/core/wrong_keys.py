"""Keys of a document that could not be read: what else is said of the document must not follow from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

UNKNOWN = "unknown key"  # it is in nobody's way: the document is read without it
ABSENT = ("missing", "must be a mapping")


@dataclass(frozen=True)
class WrongKeys:
    """Keys whose value is missing or wrong."""

    keys: tuple[str, ...] = ()

    def touch(self, key: str) -> bool:
        """Return whether one of them is this key, below it or above it."""
        return any(_is_at_or_below(one, key) or _is_at_or_below(key, one) for one in self.keys)

    def free(self, problems: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
        """The problems (key, text) that none of them touches."""
        return ((key, text) for key, text in problems if not self.touch(key))

    def beside(self, problems: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
        """The problems (key, text) of which the key is none of them, nor below one."""
        return ((key, text) for key, text in problems if not any(_is_at_or_below(key, one) for one in self.keys))


NOTHING_WRONG = WrongKeys()


def wrong_keys(problems: Iterable[str]) -> WrongKeys:
    """The keys that problems of a document name, each as `<key>: <text>`."""
    pairs = [_parts(problem) for problem in problems]
    return WrongKeys(tuple(key for key, text in pairs if not text.startswith(UNKNOWN)))


def without_consequences(problems: Iterable[str]) -> Sequence[str]:
    """The problems but those that follow from others: of what is missing or no mapping nothing more is said."""
    kept: list[str] = []
    absent: list[str] = []
    for problem in problems:
        key, text = _parts(problem)
        if any(_is_at_or_below(key, one) for one in absent):
            continue
        kept.append(problem)
        if text.startswith(ABSENT):
            absent.append(key)
    return kept


def _parts(problem: str) -> tuple[str, str]:
    key, _, text = problem.partition(": ")
    return key, text


def _is_at_or_below(key: str, other: str) -> bool:
    return key == other or key.startswith((f"{other}.", f"{other}["))
