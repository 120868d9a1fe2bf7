"""Expressions in the Common Expression Language (package common-expression-language, module `cel`).

Used in processes of their own only: the library is large, and what it does with a wrong expression is its own affair.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import cel


class Expression:
    """A compiled expression over named values; ValueError says where it cannot be read."""

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            self._program = cel.compile(text)
        except Exception as error:
            raise ValueError(f"cannot be read: {_one_line(error)}") from error

    def holds(self, values: Mapping[str, Any]) -> bool:
        """Its value; ValueError when it has none for these values, or one that is neither true nor false."""
        try:
            found = self._program.execute(dict(values))
        except Exception as error:
            raise ValueError(f"{self.text}: {_one_line(error)}") from error
        if not isinstance(found, bool):
            raise ValueError(f"{self.text}: is {type(found).__name__}, not true or false")
        return found


def _one_line(error: Exception) -> str:
    return re.sub(r"\s+", " ", str(error))[:300] or type(error).__name__
