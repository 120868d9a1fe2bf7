"""What admission adds to the creation of a pod: 500 images in the list, with and without it in one run.

Measured by the module COST of the tests on two real API servers side by side. Other work on the machine shows in both;
the difference of two 99th percentiles is taken in ROUNDS, and their median counts. All goes to
build/bench/admission.json.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from benchmarks.measuring.comparisons import Comparison, quantiles, record
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.machine import preparing

RECORD = PROJECT / "build" / "bench" / "admission.json"
COST = "tests.stages.kubernetes.admission_cost"
FOLDERS = (PROJECT, PROJECT / "operator" / "src", PROJECT / "operator")
DIGESTS, PODS, ROUNDS = 500, 2000, 5
GOAL_MS = 1.0
RELOAD_GOAL_SECONDS = 1.0
SECONDS_MAX = 600


def compare() -> list[Comparison]:
    """The addition to a pod's creation, and how long a new list takes, each against its goal."""
    measured = _measured()
    judged, free = measured["creations_ms"]["with"], measured["creations_ms"]["without"]
    p50 = quantiles(judged).p50 - quantiles(free).p50
    p99 = statistics.median(_p99(a) - _p99(b) for a, b in zip(_rounds(judged), _rounds(free), strict=True))
    reload_s = measured["reload_s"][str(DIGESTS)]
    record(
        RECORD,
        {
            "pod_with_ms": asdict(quantiles(judged)),
            "pod_without_ms": asdict(quantiles(free)),
            "added_p50_ms": round(p50, 3),
            "added_p99_ms": round(p99, 3),
            "validation_mean_ms": round(measured["validation_mean_ms"], 3),
            "reload_500_s": round(reload_s, 3),
            "reload_5000_s": round(measured["reload_s"][str(10 * DIGESTS)], 3),
        },
    )
    goal = "the goal"
    return [
        Comparison(f"admission, {DIGESTS} images, added (p50)", "ms", p50, GOAL_MS, 1.0, goal),
        Comparison(f"admission, {DIGESTS} images, added (p99)", "ms", p99, GOAL_MS, 1.0, goal),
        Comparison("a new list at work", "s", reload_s, RELOAD_GOAL_SECONDS, 1.0, goal),
    ]


def _p99(values: Sequence[float]) -> float:
    return quantiles(values).p99


def _rounds(values: Sequence[float]) -> list[Sequence[float]]:
    size = len(values) // ROUNDS
    return [values[start : start + size] for start in range(0, size * ROUNDS, size)]


def _measured() -> dict[str, Any]:
    """What COST prints."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, FOLDERS)),
        preparing.TOOLCHAIN_VARIABLE: str(preparing.tool_chain()),
    }
    command = [sys.executable, "-m", COST, str(DIGESTS), str(PODS)]
    done = subprocess.run(
        command, env=environment, cwd=PROJECT, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
    )
    if done.returncode:
        raise SetUpError(f"{COST} ended with {done.returncode}: {done.stderr[-2000:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))
