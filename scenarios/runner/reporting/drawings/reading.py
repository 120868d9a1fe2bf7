"""Series of a document. What is no finite number is left out: a report is drawn however odd its data are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

Document = Mapping[str, Any]


def finite(value: object) -> float | None:
    """A number, or None."""
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if known else None  # type: ignore[arg-type]


def rows(series: Document, *names: str) -> list[tuple[float, ...]]:
    """The rows of several lists, those with a number in every list."""
    together = zip(*(series.get(name) or () for name in names), strict=False)
    numbers = (tuple(finite(value) for value in row) for row in together)
    return [tuple(value for value in row if value is not None) for row in numbers if None not in row]


def at(track: Sequence[tuple[float, ...]], seconds: float) -> tuple[float, ...] | None:
    """The other values of a track at a time, between two rows on the straight line; None outside."""
    for before, after in pairwise(track):
        if before[0] <= seconds <= after[0]:
            share = (seconds - before[0]) / (after[0] - before[0]) if after[0] > before[0] else 0.0
            return tuple(one + share * (other - one) for one, other in zip(before[1:], after[1:], strict=True))
    return None
