"""The merge latency of a task on a real forge: manager and gate against the forge alone, in the same run.

`forge_floor_ms` is the p95 of proposing a one-line change by AGit and pushing it to main while manager and gate stand
still, half of it before and half after the tasks: less is not possible on that forge. `task_to_merged_ms` is the median
from a task's creation to the manager's knowing that its plan is on main, `gate_check_p95_ms` what the gate's checks
take of that. All go to build/bench/registry.json, the merge latency with all its quantiles to
build/bench/application-manager.json.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys

from benchmarks.application_manager import record_merge_latency
from benchmarks.measuring import Comparison
from benchmarks.registry import record
from ci import preparing
from ci.errors import SetUpError
from ci.folders import PROJECT

PLANS = 50
ALLOWANCE_MS = 150.0
GOAL_MS = 300.0
SECONDS_MAX = 600


def measure() -> dict[str, list[float]]:
    """Milliseconds of each round, by what was measured."""
    folders = os.pathsep.join(str(path) for path in (PROJECT, PROJECT / "operator" / "src", PROJECT / "operator"))
    environment = {**os.environ, "PYTHONPATH": folders, preparing.TOOLCHAIN_VARIABLE: str(preparing.tool_chain())}
    command = [sys.executable, "-m", "tests.stages.delivery.merge_latency", str(PLANS)]
    done = subprocess.run(
        command, env=environment, cwd=PROJECT, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
    )
    if done.returncode:
        raise SetUpError(f"{command[2]} ended with {done.returncode}: {done.stderr[-2000:]}")
    milliseconds: dict[str, list[float]] = json.loads(done.stdout.splitlines()[-1])
    return milliseconds


def p95(values: list[float]) -> float:
    """The value that 95 % do not exceed."""
    return sorted(values)[round(0.95 * (len(values) - 1))]


def compare() -> list[Comparison]:
    """Task to main against the forge alone."""
    milliseconds = measure()
    ours, floor = statistics.median(milliseconds["tasks"]), p95(milliseconds["floor"])
    record_merge_latency(milliseconds["tasks"], milliseconds["floor"])
    record(
        {
            "forge_floor_ms": round(floor, 1),
            "forge_floor_median_ms": round(statistics.median(milliseconds["floor"]), 1),
            "gate_check_p95_ms": round(p95(milliseconds["checks"]), 1),
            "task_to_merged_ms": round(ours, 1),
            "task_to_merged_p95_ms": round(p95(milliseconds["tasks"]), 1),
        }
    )
    bound = max(GOAL_MS, floor + ALLOWANCE_MS)
    name = f"task to main, median of {PLANS}"
    return [Comparison(name, "ms", ours, floor, bound / floor, "propose and push, p95")]
