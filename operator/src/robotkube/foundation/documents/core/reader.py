"""Strict reading of documents: every key known, every problem named before anything is refused."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.yaml_codec import join


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
            self.problems.append(f"{path or 'document'}: must be a mapping")
            return {}
        required = set(required)
        known = set(required) | set(optional)
        self.problems += [f"{join(path, key)}: missing" for key in sorted(required - set(value))]
        self.problems += [f"{join(path, key)}: unknown key; remove it" for key in sorted(set(value) - known)]
        return value

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

    def sequence(self, value: Any, path: str) -> list[Any]:
        """The list `value`; empty when it is missing or a problem."""
        if value is None:
            return []
        if not isinstance(value, list):
            self.problems.append(f"{path}: must be a list")
            return []
        return value
