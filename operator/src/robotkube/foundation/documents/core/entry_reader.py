"""The strict reader of catalogue entries, and lists of words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import join

ITEMS_MAX = 256  # of any list


class EntryReader(Reader):
    """A reader of the catalogue's entries, in which a key is left out and never null."""

    def mapping(
        self, value: Any, path: str, required: Iterable[str], optional: Iterable[str] = ()
    ) -> Mapping[str, Any]:
        """As `Reader.mapping`."""
        required = set(required)
        known = required | set(optional)
        entry = super().mapping(value, path, required, known)
        empty = sorted(key for key in known if key in entry and entry[key] is None)
        self.problems += [f"{join(path, key)}: is null; write a value or remove the key" for key in empty]
        return entry

    def sequence(self, value: Any, path: str) -> list[Any]:
        """As `Reader.sequence`; only the first ITEMS_MAX of a longer list, which is refused."""
        items = super().sequence(value, path)
        if len(items) > ITEMS_MAX:
            self.problems.append(f"{path}: has {len(items)} items, at most {ITEMS_MAX} are allowed; split it")
        return items[:ITEMS_MAX]


def read_words(reader: Reader, value: Any, path: str, pattern: re.Pattern[str]) -> tuple[str, ...]:
    """The texts of a list, each of which may stand there once."""
    words = [reader.word(item, f"{path}[{i}]", pattern) for i, item in enumerate(reader.sequence(value, path))]
    twice = sorted({word for word in words if word and words.count(word) > 1})
    reader.problems += [f"{path}: {word!r} stands twice; keep one of them" for word in twice]
    return tuple(words)


def read_one_of(reader: Reader, value: Any, path: str, words: Iterable[str]) -> str:
    """The value, which must be one word of a closed list."""
    allowed = tuple(words)
    if not isinstance(value, str) or value not in allowed:
        reader.problems.append(f"{path}: {value!r:.40} must be one of {', '.join(allowed)}")
        return ""
    return value
