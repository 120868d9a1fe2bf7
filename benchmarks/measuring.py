"""What a benchmark is: what is measured of ours and of a baseline, taken in the same run on the same machine.

Only the ratio of the two is judged; seconds alone would say more about the machine than about the code.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Comparison:
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


@dataclass(frozen=True)
class Quantiles:
    """How many values, and what 50, 95 and 99 % of them do not exceed."""

    n: int
    p50: float
    p95: float
    p99: float


def quantiles(values: Sequence[float]) -> Quantiles:
    """Of at least one value, rounded to thousandths."""
    ordered = sorted(values)
    return Quantiles(len(ordered), *(round(ordered[round(q * (len(ordered) - 1))], 3) for q in (0.5, 0.95, 0.99)))


def record(path: Path, values: Mapping[str, Any]) -> None:
    """Add values to a record, replacing those of the same name."""
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(kept | dict(values), indent=1, sort_keys=True) + "\n", encoding="utf-8")
