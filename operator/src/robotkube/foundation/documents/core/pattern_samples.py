"""Texts that a regular expression matches, made from the expression: a few of the shortest.

They are guesses: look-around and back references are not followed, so the caller tries each. Python's own parser reads
the expression, as JSON Schema's `pattern` is matched here; it is not promised to stay (Python is 3.11 or 3.12, and the
tests show the forms that are read).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from re import _constants as kinds
from re import _parser as parser
from typing import Any

CHARACTERS_MAX = 200
PARTS_MAX = 2000
VARIANTS = 4
PATTERNS_KEPT = 256
_CHARACTERS = dict.fromkeys("abcxyzABC012_-./ " + "".join(map(chr, range(32, 127))))  # the first ones are preferred
_CATEGORIES = {
    kinds.CATEGORY_DIGIT: r"\d", kinds.CATEGORY_SPACE: r"\s", kinds.CATEGORY_WORD: r"\w",
    kinds.CATEGORY_NOT_DIGIT: r"\D", kinds.CATEGORY_NOT_SPACE: r"\S", kinds.CATEGORY_NOT_WORD: r"\W",
}  # fmt: skip


def fitting(pattern: str) -> Sequence[str]:
    """Texts for a pattern, none when it is none, or too deep, or asks for more than CHARACTERS_MAX characters."""
    try:
        return _fitting(pattern)
    except (re.error, RecursionError, OverflowError):
        return ()


@lru_cache(maxsize=PATTERNS_KEPT)
def _fitting(pattern: str) -> Sequence[str]:
    """These texts; those of the last patterns are kept, since the schemas of a catalogue have the same few again and
    again."""
    parts = parser.parse(pattern)
    texts = []
    for variant in range(VARIANTS):
        try:
            texts.append(_Text(variant).of(parts))
        except _NoTextError:
            continue
    return tuple(texts)


class _NoTextError(Exception):
    """There is no text, or none as short as a sample shall be."""


class _Text:
    """Makes one text. Its `variant` says how often what may repeat does so beyond what it must, and which of the
    characters and branches that are allowed is taken."""

    def __init__(self, variant: int) -> None:
        self._variant = variant
        self._parts = PARTS_MAX

    def of(self, parts: Any) -> str:
        """The text of a sequence of parts."""
        text = ""
        for kind, value in parts:
            self._parts -= 1
            text += self._of_one(kind, value)
            if self._parts < 0 or len(text) > CHARACTERS_MAX:
                raise _NoTextError
        return text

    def _of_one(self, kind: Any, value: Any) -> str:
        if kind is kinds.LITERAL:
            return chr(value)
        if kind in (kinds.ANY, kinds.NOT_LITERAL, kinds.IN):
            return self._character(kind, value)
        if kind is kinds.BRANCH:
            return self.of(value[1][self._variant % len(value[1])])
        if kind is kinds.SUBPATTERN:
            return self.of(value[3])
        if kind is kinds.ATOMIC_GROUP:
            return self.of(value)
        if kind in (kinds.MAX_REPEAT, kinds.MIN_REPEAT, kinds.POSSESSIVE_REPEAT):
            least, most, inner = value
            count = min(least + self._variant, int(most))
            return "".join(self.of(inner) for _ in range(min(count, CHARACTERS_MAX + 1)))
        return ""  # anchors, and what is not followed

    def _character(self, kind: Any, value: Any) -> str:
        allowed = [character for character in _CHARACTERS if _allows(kind, value, character)]
        if not allowed:
            raise _NoTextError
        return allowed[self._variant % min(len(allowed), VARIANTS)]


def _allows(kind: Any, value: Any, character: str) -> bool:
    """Return whether one part, of a single character, allows this one."""
    if kind is kinds.IN:
        negated = value[0][0] is kinds.NEGATE
        return negated != any(_allows(inner, of_it, character) for inner, of_it in value if inner is not kinds.NEGATE)
    if kind is kinds.CATEGORY:
        return re.fullmatch(_CATEGORIES[value], character) is not None
    if kind is kinds.RANGE:
        return bool(value[0] <= ord(character) <= value[1])
    return kind is kinds.ANY or (ord(character) == value) == (kind is kinds.LITERAL)
