"""Scales: from values to places, with round ticks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

STEPS = (1.0, 2.0, 5.0, 10.0)
TICKS = 6


@dataclass(frozen=True)
class Scale:
    """Linear: `low` stands at `begin`, `high` at `end`."""

    low: float
    high: float
    begin: float
    end: float

    def __call__(self, value: float) -> float:
        """The place of a value."""
        return self.begin + (value - self.low) / (self.high - self.low) * (self.end - self.begin)

    def inside(self, value: float) -> float:
        """The place of a value, or the end of the scale that is nearest to it."""
        return self(min(max(value, self.low), self.high))

    def ticks(self, count: int = TICKS) -> tuple[float, ...]:
        """Round values on the scale, at most about `count`."""
        step = step_of((self.high - self.low) / count)
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return tuple(number * step for number in range(first, last + 1))


def step_of(width: float) -> float:
    """The least of 1, 2, 5, 10, ... that is not below `width`."""
    power = 10.0 ** math.floor(math.log10(width))
    return next((step * power for step in STEPS if step * power >= width * (1 - 1e-9)), 10 * power)


def scale(values: Iterable[float], begin: float, end: float, least: float = 1.0) -> Scale:
    """The scale of the values, at least `least` wide."""
    known = list(values)
    low = min(known, default=0.0)
    high = max(known, default=0.0)
    missing = max(0.0, least - (high - low)) / 2
    return Scale(low - missing, high + missing, begin, end)


def upwards(values: Iterable[float], begin: float, end: float, least: float = 1.0) -> Scale:
    """A scale from 0 to the greatest value, and a little more."""
    return Scale(0.0, max([*values, 0.0]) * 1.05 or least, begin, end)


def number(value: float) -> str:
    """A tick's value."""
    return f"{value:.6g}"
