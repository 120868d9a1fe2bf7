"""Fewer values of a series: of neighbours one remains."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Value = TypeVar("Value")

POINTS_MAX = 300
HERTZ = 5
"""Of positions: a vehicle at 20 m/s is every 4 m."""


def groups(values: Sequence[Value], points_max: int = POINTS_MAX) -> Iterator[Sequence[Value]]:
    """Neighbours that become one value each, all of one length but the last, at most `points_max` of them."""
    size = max(1, math.ceil(len(values) / points_max))
    return (values[begin : begin + size] for begin in range(0, len(values), size))


def every(values: Sequence[Value], key: Callable[[Value], int], period: int) -> Iterator[Value]:
    """The first value of each period, by its key; the values are in order of it."""
    last = None
    for value in values:
        if last is None or key(value) // period != last:
            last = key(value) // period
            yield value
