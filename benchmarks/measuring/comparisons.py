"""What a benchmark is: what is measured of ours and of a baseline, taken in the same run on the same machine.

Only the ratio of the two is judged; seconds alone would say more about the machine than about the code.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.machine import preparing


@dataclass(frozen=True)
class Comparison:
    """What was measured beside its baseline: `ours` and `baseline` in `unit`; `ratio_max` is what ours / baseline may
    be."""

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
        """Return whether the ratio is within its bound."""
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


def module_environment() -> dict[str, str]:
    """The environment of a process that runs a module of the tests' stages."""
    folders = os.pathsep.join(str(path) for path in (PROJECT, PROJECT / "operator" / "src", PROJECT / "operator"))
    return {**os.environ, "PYTHONPATH": folders}


def staged(module: str, count: int, seconds_max: float) -> dict[str, list[float]]:
    """Milliseconds of each of `count` rounds by what was measured, as a module of the tests' stages measures them on
    real programs. SetUpError with its last words when it fails."""
    environment = module_environment() | {preparing.TOOLCHAIN_VARIABLE: str(preparing.tool_chain())}
    command = [sys.executable, "-m", f"tests.stages.{module}", str(count)]
    done = subprocess.run(
        command, env=environment, cwd=PROJECT, capture_output=True, text=True, timeout=seconds_max, check=False
    )
    if done.returncode:
        raise SetUpError(f"{command[2]} ended with {done.returncode}: {done.stderr[-2000:]}")
    milliseconds: dict[str, list[float]] = json.loads(done.stdout.splitlines()[-1])
    return milliseconds
