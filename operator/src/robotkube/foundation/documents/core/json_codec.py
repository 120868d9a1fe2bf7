"""JSON that others wrote, read to a bounded depth: no document may end a reader that recurses.

This is the one place that knows what Python does with deep JSON. `read_json` refuses it; `read_json_shortened` is for
lists and watches of the API server, where one deep object must not hide the others.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from typing import Any

LEVELS_MAX = 100  # beyond what any document here may have, and far below what ends a reader
TOO_DEEP = f"nested deeper than {LEVELS_MAX} levels; write it flatter"

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"?|[\[\]{}]', re.DOTALL)  # a text may lack its end: never looked for twice


def read_json(
    text: str | bytes,
    pairs: Callable[[list[tuple[str, Any]]], Any] | None = None,
    constant: Callable[[str], Any] | None = None,
) -> Any:
    """The value in `text`. ValueError when it is no JSON in a Unicode encoding, or has more than LEVELS_MAX levels.
    `pairs` makes the value of an object, `constant` that of NaN and infinities, as with `json.loads`."""
    try:
        value = json.loads(text, object_pairs_hook=pairs, parse_constant=constant)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    if _is_too_deep(text, value):
        raise ValueError(TOO_DEEP)
    return value


def read_json_shortened(text: str | bytes) -> Any:
    """The value in `text`; in one of more than LEVELS_MAX levels what lies below is null. ValueError when it is no
    JSON."""
    try:
        value = json.loads(text)
    except RecursionError:
        return _shortened(text)
    return _shortened(text) if _is_too_deep(text, value) else value


def _is_too_deep(text: str | bytes, value: Any) -> bool:
    """Return whether `value`, which stands in `text`, has more than LEVELS_MAX levels."""
    if _opened(text) <= LEVELS_MAX:
        return False
    level = [value]
    for _ in range(LEVELS_MAX):
        level = [inner for outer in level for inner in _items(outer) if isinstance(inner, (dict, list))]
        if not level:
            return False
    return True


def _opened(text: str | bytes) -> int:
    """The most levels that `text` can have."""
    if isinstance(text, bytes):
        return text.count(b"[") + text.count(b"{")
    return text.count("[") + text.count("{")


def _items(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def _shortened(text: str | bytes) -> Any:
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
