"""Expressions in the Common Expression Language (package common-expression-language, module `cel`).

Used in processes of their own only: the library is large, and what it does with a wrong expression is its own affair.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

import cel

SAMPLES = (1.5, 7, True, "text", (1.5, 2.5), (7, 8), ("text", "other"), (True, False))
_UNDEFINED = "Undefined variable or function"
_NO_TRUTHS = frozenset(["int", "float", "str", "bytes", "list", "dict", "NoneType"])
_LOOP = re.compile(r"\.\s*(?:all|exists|exists_one|map|filter)\s*\(\s*(\w+)\s*,(?:\s*(\w+)\s*,)?")


class Expression:
    """A compiled expression over named values; ValueError says where it cannot be read."""

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            self._program = cel.compile(text)
        except Exception as error:
            raise ValueError(f"cannot be read: {_one_line(error)}") from error

    def unknown(self, names: Collection[str]) -> str:
        """The part of the expression that is none of `names` (of two agents: `a.x`) and nothing of CEL, in words; empty
        when all is known.

        An unknown name is reported whatever the values are. What depends on the values is tried on values of every
        sort, and reported when it is wrong with all of them.
        """
        for name in sorted(set(self._program.variables()) - {name.partition(".")[0] for name in names} - self._bound()):
            if _UNDEFINED in _outcome(cel.compile(name), {}):
                return f"{name} is none of the names in fields ({', '.join(sorted(names))}); use one of them, or add it"
        outcomes = [_outcome(self._program, _sample(names, value)) for value in SAMPLES]
        if len(set(outcomes)) == 1 and (_UNDEFINED in outcomes[0] or outcomes[0].startswith("KeyError")):
            return f"cannot be evaluated: {outcomes[0]}"
        no_truth = next((kind for kind in outcomes if kind in _NO_TRUTHS), "")
        if no_truth and "bool" not in outcomes:
            return f"is {no_truth}, not true or false; compare it with something"
        return ""

    def _bound(self) -> set[str]:
        """The names that its own macros bind, such as i in `v.exists(i, i > 1.0)`."""
        return {name for pair in _LOOP.findall(self.text) for name in pair if name}

    def holds(self, values: Mapping[str, Any]) -> bool:
        """The expression's value; ValueError when it has none for these values, or one that is neither true nor
        false."""
        try:
            value = self._program.execute(dict(values))
        except Exception as error:
            raise ValueError(f"{self.text}: {_one_line(error)}") from error
        if not isinstance(value, bool):
            raise ValueError(f"{self.text}: is {type(value).__name__}, not true or false")
        return value


def _sample(names: Collection[str], value: Any) -> dict[str, Any]:
    """Sample values for all names; `agent` is always a text."""
    values: dict[str, Any] = {}
    for name in names:
        outer, _, inner = name.rpartition(".")
        (values.setdefault(outer, {}) if outer else values)[inner] = "agent-0" if inner == "agent" else value
    return values


def _outcome(program: Any, values: Mapping[str, Any]) -> str:
    """The name of the value's type, or the error."""
    try:
        return type(program.execute(dict(values))).__name__
    except Exception as error:
        return f"{type(error).__name__}: {_one_line(error)}"


def _one_line(error: Exception) -> str:
    return re.sub(r"\s+", " ", str(error))[:300] or type(error).__name__
