"""What a benchmark is: a figure of ours and one of a baseline, taken in the same run on the same machine.

Only the ratio of the two is judged; seconds alone would say more about the machine than about the code.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """`ours` and `baseline` in `unit`; `ratio_max` is what ours / baseline may be."""

    name: str
    unit: str
    ours: float
    baseline: float
    ratio_max: float
    baseline_is: str

    @property
    def ratio(self) -> float:
        """Ours / baseline; infinite when the baseline is zero."""
        return self.ours / self.baseline if self.baseline else float("inf")

    @property
    def passed(self) -> bool:
        """Whether the ratio is within its bound."""
        return self.ratio <= self.ratio_max


def seconds(work: Callable[[], object], repetitions: int) -> float:
    """Median wall time of `work`, in seconds."""
    times = []
    for _ in range(repetitions):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return statistics.median(times)
