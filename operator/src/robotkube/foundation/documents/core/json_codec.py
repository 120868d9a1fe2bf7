"""A reader of JSON that others wrote, whatever its depth: a reader that recurses must not be ended by one deep
object."""

from __future__ import annotations

import json
import re
from typing import Any

LEVELS_MAX = 100  # beyond what any document here may have, and far below what ends a reader

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{}]', re.DOTALL)


def read_json(text: str | bytes) -> Any:
    """The value in `text`; in one that is nested too deeply for the reader, what lies below LEVELS_MAX is null.
    ValueError when it is no JSON."""
    try:
        return json.loads(text)
    except RecursionError:
        return json.loads(_flattened(text if isinstance(text, str) else text.decode()))


def _flattened(text: str) -> str:
    kept: list[str] = []
    level = 0
    begin = 0
    for token in _TOKEN.finditer(text):
        opens, closes = token[0] in "[{", token[0] in "]}"
        if opens and level == LEVELS_MAX:
            kept += [text[begin : token.start()], "null"]
        level += opens - closes
        if closes and level == LEVELS_MAX:
            begin = token.end()
    return "".join(kept) + (text[begin:] if level <= LEVELS_MAX else "")
