"""Strict reading of a mapping key by key: all problems are collected, each with its key and fix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from robotkube.foundation.documents.core.patterns import SUBDOMAIN
from robotkube.robots.ros.core.topic_patterns import UNREADABLE_TOPIC, TopicPattern

NAME_LENGTH_MAX = 100

T = TypeVar("T")


class SettingsReader:
    """Reads the keys of one mapping, collects problems, and knows at the end which keys nobody asked for.

    After a problem the getters return something of the right type: the document is refused anyway.
    """

    def __init__(self, value: object, path: str, problems: list[str]) -> None:
        self._values: Mapping[str, Any] = value if isinstance(value, Mapping) else {}
        self._path, self._problems = path, problems
        self._asked: set[str] = set()
        if not isinstance(value, Mapping):
            problems.append(f"{path or 'the document'}: must be a mapping")

    def problem(self, key: str, text: str) -> None:
        self._problems.append(f"{self._key(key)}: {text}")

    def has(self, key: str) -> bool:
        return key in self._values

    def done(self) -> None:
        for key in sorted(set(self._values) - self._asked, key=str):
            self.problem(str(key), f"unknown key; known are {', '.join(sorted(self._asked))}")

    def keys(self) -> list[Any]:
        return list(self._values)

    def anything(self, key: str) -> Any:
        return self._take(key, None)

    def text(self, key: str, default: str | None = None) -> str:
        value = self._take(key, default)
        if isinstance(value, str) and (value or default == ""):
            return value
        return self._wrong(key, value, "must be a text that is not empty", "")

    def name(self, key: str) -> str:
        value = self._take(key, None)
        if isinstance(value, str) and len(value) <= NAME_LENGTH_MAX and SUBDOMAIN.fullmatch(value):
            return value
        return self._wrong(key, value, f"must be a name of at most {NAME_LENGTH_MAX} of a-z, 0-9, - and .", "")

    def choice(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        value = self._take(key, default)
        if isinstance(value, str) and value in choices:
            return value
        return self._wrong(key, value, f"must be one of {', '.join(choices)}", choices[0])

    def number(self, key: str, least: float, most: float, default: float | None = None) -> float:
        value = self._take(key, default)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most:
            return value
        return self._wrong(key, value, f"must be a number from {least:g} to {most:g}{_instead_of(value)}", least)

    def whole(self, key: str, least: int, most: int, default: int | None = None) -> int:
        value = self._take(key, default)
        if (
            isinstance(value, (int, float))
            and not isinstance(value, bool)
            and least <= value <= most
            and value % 1 == 0
        ):
            return int(value)
        return self._wrong(key, value, f"must be a whole number from {least} to {most}{_instead_of(value)}", least)

    def flag(self, key: str, default: bool) -> bool:
        value = self._take(key, default)
        return value if isinstance(value, bool) else self._wrong(key, value, "must be true or false", default)

    def texts(self, key: str, least: int) -> tuple[str, ...]:
        value = self._take(key, None)
        texts = isinstance(value, list) and all(isinstance(item, str) and item for item in value)
        if texts and len(value) >= least and len(set(value)) == len(value):
            return tuple(value)
        return self._wrong(key, value, f"must be a list of at least {least} different texts", ())

    def pattern(self, key: str) -> TopicPattern:
        text = self.text(key)
        try:
            return TopicPattern(text)
        except ValueError as error:
            if text:
                self.problem(key, str(error))
            return TopicPattern(UNREADABLE_TOPIC)

    def mapping(self, key: str, required: bool = True) -> SettingsReader:
        return SettingsReader(self._take(key, None if required else {}), self._key(key), self._problems)

    def plain(self, key: str) -> Mapping[str, Any]:
        value = self._take(key, {})
        return value if isinstance(value, Mapping) else self._wrong(key, value, "must be a mapping", {})

    def items(self, key: str, most: int, required: bool = True) -> list[SettingsReader]:
        value = self._take(key, None if required else [])
        if not isinstance(value, list) or len(value) > most or (required and not value):
            return self._wrong(key, value, f"must be a list of {'1' if required else '0'} to {most} mappings", [])
        return [SettingsReader(item, f"{self._key(key)}[{index}]", self._problems) for index, item in enumerate(value)]

    def _take(self, key: str, default: Any) -> Any:
        self._asked.add(key)
        return self._values.get(key, default)

    def _key(self, key: str) -> str:
        return ".".join(part for part in (self._path, key) if part)

    def _wrong(self, key: str, value: object, text: str, instead: T) -> T:
        self.problem(key, f"{'is missing; it ' if value is None else ''}{text}")
        return instead


def _instead_of(value: object) -> str:
    """What stands where a number has to be: YAML takes 3e1, 30m and 1,5 for text."""
    return f", not the text {value!r:.40}; without unit and quotes, as 30 or 1.5" if isinstance(value, str) else ""
