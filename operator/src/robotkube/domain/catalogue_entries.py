"""What every kind of catalogue entry has in common: its head, and loops over one variable."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.domain.documents import Reader
from robotkube.domain.releases import NAME
from robotkube.domain.texts import join, read_mapping

API = "registry.robotkube.io/v1alpha1"
PROVIDES = re.compile(r"[a-z0-9-]+(/[a-z0-9-]+)*", re.ASCII)
DESCRIPTION_CHARACTERS_MAX = 1000
ITEMS_MAX = 256  # of any list

_VARIABLE = re.compile(r"[a-z][a-z0-9_]*", re.ASCII)


class EntryReader(Reader):
    """Reads entries of the catalogue, in which a key is left out and never null."""

    def mapping(
        self, value: Any, path: str, required: Iterable[str], optional: Iterable[str] = ()
    ) -> Mapping[str, Any]:
        """As `Reader.mapping`."""
        required = set(required)
        known = required | set(optional)
        found = super().mapping(value, path, required, known)
        empty = sorted(key for key in known if key in found and found[key] is None)
        self.problems += [f"{join(path, key)}: is null; write a value or remove the key" for key in empty]
        return found

    def sequence(self, value: Any, path: str) -> list[Any]:
        """As `Reader.sequence`; only the first ITEMS_MAX of a longer list, which is refused."""
        found = super().sequence(value, path)
        if len(found) > ITEMS_MAX:
            self.problems.append(f"{path}: has {len(found)} items, at most {ITEMS_MAX} are allowed; split it")
        return found[:ITEMS_MAX]


def read_head(reader: Reader, text: str, kind: str, parts: Iterable[str] = ()) -> tuple[Mapping[str, Any], str]:
    """The document in `text` and metadata.name; `parts` are optional keys beside the four that all entries have."""
    required = ["apiVersion", "kind", "metadata", "spec"]
    document = reader.mapping(read_mapping(text, reader.where), "", required, parts)
    reader.equal(document.get("apiVersion"), "apiVersion", API)
    reader.equal(document.get("kind"), "kind", kind)
    metadata = reader.mapping(document.get("metadata") or {}, "metadata", ["name"])
    return document, reader.word(metadata.get("name"), "metadata.name", NAME)


def read_description(reader: Reader, value: Any, path: str) -> str:
    """A text for people that is not empty."""
    text = reader.prose(value, path)
    if isinstance(value, str) and not 0 < len(text) <= DESCRIPTION_CHARACTERS_MAX:
        reader.problems.append(f"{path}: must have 1 to {DESCRIPTION_CHARACTERS_MAX} characters")
    return text


def read_words(reader: Reader, value: Any, path: str, pattern: re.Pattern[str]) -> tuple[str, ...]:
    """A list of texts, each once."""
    found = [reader.word(item, f"{path}[{i}]", pattern) for i, item in enumerate(reader.sequence(value, path))]
    twice = sorted({word for word in found if word and found.count(word) > 1})
    reader.problems += [f"{path}: {word!r} stands twice; keep one of them" for word in twice]
    return tuple(found)


def read_for_each(reader: Reader, value: Any, path: str, reserved: frozenset[str]) -> Mapping[str, Any]:
    """One variable and its list (or a template that gives one); nothing when `value` is None."""
    found = value if value is not None else {}
    if not isinstance(found, Mapping) or len(found) > 1:
        reader.problems.append(f"{path}: must be one variable and its list")
        return {}
    for variable, values in found.items():
        reader.text(variable, path, _VARIABLE)
        if variable in reserved:
            reader.problems.append(f"{path}: the name {variable!r} is taken; choose another")
        if not isinstance(values, (list, str)):
            reader.problems.append(f"{path}.{variable}: must be a list or a template that gives one")
    return found


def read_one_of(reader: Reader, value: Any, path: str, words: Iterable[str]) -> str:
    """One word of a closed list."""
    allowed = tuple(words)
    if not isinstance(value, str) or value not in allowed:
        reader.problems.append(f"{path}: {value!r:.40} must be one of {', '.join(allowed)}")
        return ""
    return value
