"""Trailers of commit messages, `RobotKube-<Key>: <word>`, one in a line: the one place that writes and reads them.

Keys are given without what all begin with. What a key's word looks like, and which keys stand together, is the business
of who reads them (delivery.deployment.core.commit_messages for plans).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

PULL_REQUEST = "Pull-Request"  # of what the gate merges: its number,
APPROVED_BY = "Approved-By"  # and one for each account that approved it
EMERGENCY = "Break-Glass"  # of what people signed: its time,
SIGNED_BY = "Signed-By"  # and a name with a signature, two words

_BEGIN = "RobotKube-"
_TRAILER = re.compile(rf"{_BEGIN}([A-Z][a-z]+(?:-[A-Z][a-z]+)*): (\S+)")


def named(key: str) -> str:
    """The whole name of a trailer, as messages to people have it."""
    return f"{_BEGIN}{key}"


def trailer(key: str, word: object) -> str:
    """A trailer as a line, without its end."""
    return f"{_BEGIN}{key}: {word}"


def read_trailer(line: str) -> tuple[str, str] | None:
    """The key and the word of a line; None when it is no trailer."""
    match = _TRAILER.fullmatch(line)
    return (match[1], match[2]) if match else None


def read_trailers(message: str) -> Mapping[str, tuple[str, ...]]:
    """The words of all trailers in a commit message by their keys, in its order; other lines say nothing."""
    words: dict[str, tuple[str, ...]] = {}
    for line in message.split("\n"):
        if pair := read_trailer(line):
            key, word = pair
            words[key] = (*words.get(key, ()), word)
    return words


def claims(message: str, key: str) -> bool:
    """Return whether a line below the subject begins as such a trailer, also when its word is none."""
    return f"\n{trailer(key, '')}" in message
