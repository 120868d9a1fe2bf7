"""Strict reading of documents: every key known, every problem named before anything is refused.

`Reader` judges values that its caller has looked up, under keys that the caller lists; `MappingReader` reads the keys
of one mapping by asking for them. Both collect in one list, which `Reader.finish` refuses with the file's name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.patterns import SUBDOMAIN
from robotkube.foundation.documents.core.yaml_codec import join

NAME_LENGTH_MAX = 100

T = TypeVar("T")


class Reader:
    """Collects every problem of one document before it is refused."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.problems: list[str] = []

    def mapping(
        self, value: Any, path: str, required: Iterable[str], optional: Iterable[str] = ()
    ) -> Mapping[str, Any]:
        """The mapping `value`; empty when it is none. Missing and unknown keys are problems."""
        if not isinstance(value, Mapping):
            return self._no_mapping(path)
        required = set(required)
        known = set(required) | set(optional)
        self.problems += [f"{join(path, key)}: missing" for key in sorted(required - set(value))]
        self.problems += [f"{join(path, key)}: unknown key; remove it" for key in sorted(set(value) - known)]
        return value

    def keys_of(self, value: Any, path: str = "") -> MappingReader:
        """A reader of the keys of a mapping; of none when `value` is no mapping, which is a problem."""
        return MappingReader(self, value if isinstance(value, Mapping) else self._no_mapping(path), path)

    def text(self, value: Any, path: str, pattern: re.Pattern[str]) -> str:
        """The text `value`, which must match `pattern`; empty when it is missing or a problem."""
        if isinstance(value, str) and pattern.fullmatch(value):
            return value
        if value is not None:
            self.problems.append(f"{path}: {value!r} must match {pattern.pattern}")
        return ""

    def equal(self, value: Any, path: str, expected: Any) -> None:
        """Note a value that is there and not the expected one."""
        if value is not None and value != expected:
            self.problems.append(f"{path}: {value!r} must be {expected!r}")

    def finish(self) -> None:
        """Refuse the document with DocumentError when it has any problem."""
        if self.problems:
            raise DocumentError(self.where, self.problems)

    def word(self, value: Any, path: str, pattern: re.Pattern[str], default: str | None = None) -> str:
        """The text `value`, which must match `pattern`; when it is missing, `default`, or a problem without one."""
        if value is None and default is not None:
            return default
        if value is None:
            self.problems.append(f"{path}: missing")
        return self.text(value, path, pattern)

    def prose(self, value: Any, path: str) -> str:
        """The text `value`, whatever it says."""
        if not isinstance(value, str):
            self.problems.append(f"{path}: must be text")
            return ""
        return value

    def truth(self, value: Any, path: str) -> bool:
        """The value `true` or `false`; no when it is a problem."""
        if not isinstance(value, bool):
            self.problems.append(f"{path}: must be true or false")
        return value is True

    def sequence(self, value: Any, path: str) -> list[Any]:
        """The list `value`; empty when it is missing or a problem."""
        if value is None:
            return []
        if not isinstance(value, list):
            self.problems.append(f"{path}: must be a list")
            return []
        return value

    def _no_mapping(self, path: str) -> Mapping[str, Any]:
        self.problems.append(f"{path or 'document'}: must be a mapping")
        return {}


class MappingReader:
    """Reads the keys of one mapping, and knows at the end which of them nobody asked for.

    Problems go to the `reader`'s. After a problem the getters return something of the right type: the document is
    refused anyway.
    """

    def __init__(self, reader: Reader, values: Mapping[str, Any], path: str) -> None:
        self._reader = reader
        self._values = values
        self._path = path
        self._asked: set[str] = set()

    def problem(self, key: str, text: str) -> None:
        """Note what is wrong with a key; of the mapping itself when `key` is empty."""
        self._reader.problems.append(f"{self._key(key)}: {text}")

    def has(self, key: str) -> bool:
        """Return whether the key is there."""
        return key in self._values

    def refuse_unknown_keys(self) -> None:
        """Note every key that nobody has asked for."""
        for key in sorted(set(self._values) - self._asked, key=str):
            self.problem(str(key), f"unknown key; known are {', '.join(sorted(self._asked))}")

    def keys(self) -> list[Any]:
        """The keys that are there."""
        return list(self._values)

    def value(self, key: str, default: Any = None) -> Any:
        """The value of a key, whatever it is; `default` when it is not there."""
        self._asked.add(key)
        return self._values.get(key, default)

    def text(self, key: str, default: str | None = None) -> str:
        """A text that is not empty, unless its default is."""
        value = self.value(key, default)
        if isinstance(value, str) and (value or default == ""):
            return value
        return self._wrong(key, value, "must be a text that is not empty", "")

    def name(self, key: str) -> str:
        """A name as of an object in Kubernetes, of at most NAME_LENGTH_MAX letters."""
        value = self.value(key)
        if isinstance(value, str) and len(value) <= NAME_LENGTH_MAX and SUBDOMAIN.fullmatch(value):
            return value
        return self._wrong(key, value, f"must be a name of at most {NAME_LENGTH_MAX} of a-z, 0-9, - and .", "")

    def choice(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        """One word of a closed list."""
        value = self.value(key, default)
        if isinstance(value, str) and value in choices:
            return value
        return self._wrong(key, value, f"must be one of {', '.join(choices)}", choices[0])

    def number(self, key: str, least: float, most: float, default: float | None = None) -> float:
        """A number within bounds, which are included."""
        value = self.value(key, default)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most:
            return value
        return self._wrong(key, value, f"must be a number from {least:g} to {most:g}{_instead_of(value)}", least)

    def whole_number(self, key: str, least: int, most: int, default: int | None = None) -> int:
        """A whole number within bounds, which are included; 5.0 is one."""
        value = self.value(key, default)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if number and least <= value <= most and value % 1 == 0:
            return int(value)
        return self._wrong(key, value, f"must be a whole number from {least} to {most}{_instead_of(value)}", least)

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.value(key, default)
        return value if isinstance(value, bool) else self._wrong(key, value, "must be true or false", default)

    def texts(self, key: str, least: int) -> tuple[str, ...]:
        """A list of at least so many different texts."""
        value = self.value(key)
        texts = isinstance(value, list) and all(isinstance(item, str) and item for item in value)
        if texts and len(value) >= least and len(set(value)) == len(value):
            return tuple(value)
        return self._wrong(key, value, f"must be a list of at least {least} different texts", ())

    def mapping(self, key: str, required: bool = True) -> MappingReader:
        """The reader of the keys of a mapping; of an empty one when it is not there and need not be."""
        return self._reader.keys_of(self.value(key, None if required else {}), self._key(key))

    def any_mapping(self, key: str) -> Mapping[str, Any]:
        """A mapping with keys that somebody else knows; empty when it is not there."""
        value = self.value(key, {})
        return value if isinstance(value, Mapping) else self._wrong(key, value, "must be a mapping", {})

    def mappings(self, key: str, most: int, required: bool = True) -> list[MappingReader]:
        """The readers of a list of at most so many mappings; of at least one when it is `required`."""
        value = self.value(key, None if required else [])
        if not isinstance(value, list) or len(value) > most or (required and not value):
            return self._wrong(key, value, f"must be a list of {'1' if required else '0'} to {most} mappings", [])
        return [self._reader.keys_of(item, f"{self._key(key)}[{index}]") for index, item in enumerate(value)]

    def _key(self, key: str) -> str:
        return join(self._path, key) if key else self._path

    def _wrong(self, key: str, value: object, text: str, instead: T) -> T:
        self.problem(key, f"{'is missing; it ' if value is None else ''}{text}")
        return instead


def _instead_of(value: object) -> str:
    """What stands where a number has to be: YAML takes 3e1, 30m and 1,5 for text."""
    return f", not the text {value!r:.40}; without unit and quotes, as 30 or 1.5" if isinstance(value, str) else ""
