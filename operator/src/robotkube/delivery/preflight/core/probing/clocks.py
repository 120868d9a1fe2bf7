"""Differences of clocks: from exchanges of times over a network, and from one clock to all others."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ClockExchange:
    """One question for the time: asked and answered by the own clock, and what the other one said, in seconds."""

    asked: float
    said: float
    answered: float


def ahead(exchanges: Sequence[ClockExchange]) -> tuple[float, float]:
    """How far the other clock is ahead, and within how much, by the exchange that took the least time: whatever its
    two ways took, the difference is off by half of it at most (as NTP has it, RFC 5905). ValueError without any."""
    best = min(exchanges, key=lambda one: one.answered - one.asked)
    return best.said - (best.asked + best.answered) / 2, (best.answered - best.asked) / 2


def behind_the_middle(offsets: Mapping[str, float]) -> Mapping[str, float]:
    """How far each clock is behind the middle one of them all, given how far one clock is ahead of each. So a single
    wrong clock is named itself, also when it is the one that all were compared with."""
    middle = statistics.median_low(offsets.values()) if offsets else 0.0
    return {name: offset - middle for name, offset in offsets.items()}
