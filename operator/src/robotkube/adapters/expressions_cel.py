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
        """What in it is none of `names` (of two agents: `a.x`) and nothing of CEL, in words; empty when all is known.

        A name that cannot be found is one whatever else is true. For what depends on the values it is tried on values
        of every sort: only what is wrong with all of them is said.
        """
        for name in sorted(set(self._program.variables()) - {name.partition(".")[0] for name in names} - self._bound()):
            if _UNDEFINED in _outcome(cel.compile(name), {}):
                return f"{name} is none of the names in fields ({', '.join(sorted(names))}); use one of them, or add it"
        found = [_outcome(self._program, _sample(names, value)) for value in SAMPLES]
        if len(set(found)) == 1 and (_UNDEFINED in found[0] or found[0].startswith("KeyError")):
            return f"cannot be evaluated: {found[0]}"
        if "bool" not in found and any(kind in _NO_TRUTHS for kind in found):
            return (
                f"is {next(kind for kind in found if kind in _NO_TRUTHS)}, not true or false; compare it with something"
            )
        return ""

    def _bound(self) -> set[str]:
        """The names that its own loops bind, such as i in `v.exists(i, i > 1.0)`."""
        return {name for pair in _LOOP.findall(self.text) for name in pair if name}

    def holds(self, values: Mapping[str, Any]) -> bool:
        """Its value; ValueError when it has none for these values, or one that is neither true nor false."""
        try:
            found = self._program.execute(dict(values))
        except Exception as error:
            raise ValueError(f"{self.text}: {_one_line(error)}") from error
        if not isinstance(found, bool):
            raise ValueError(f"{self.text}: is {type(found).__name__}, not true or false")
        return found


def _sample(names: Collection[str], value: Any) -> dict[str, Any]:
    """Values for all names; `agent` is a text always."""
    found: dict[str, Any] = {}
    for name in names:
        outer, _, inner = name.rpartition(".")
        (found.setdefault(outer, {}) if outer else found)[inner] = "agent-0" if inner == "agent" else value
    return found


def _outcome(program: Any, values: Mapping[str, Any]) -> str:
    """The name of the value's type, or the error."""
    try:
        return type(program.execute(dict(values))).__name__
    except Exception as error:
        return f"{type(error).__name__}: {_one_line(error)}"


def _one_line(error: Exception) -> str:
    return re.sub(r"\s+", " ", str(error))[:300] or type(error).__name__
