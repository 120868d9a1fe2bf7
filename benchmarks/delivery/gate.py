"""The merge latency of a task on a real forge: manager and gate against the forge alone, in the same run.

`forge_floor_ms` is the p95 of proposing a one-line change by AGit and pushing it to main while manager and gate stand
still, half of it before and half after the tasks: less is not possible on that forge. `task_to_merged_ms` is the median
from a task's creation to the manager's knowing that its plan is on main, `gate_check_p95_ms` what the gate's checks
take of that. All go to build/bench/registry.json, the merge latency with all its quantiles to
build/bench/application-manager.json.
"""

from __future__ import annotations

import statistics

from benchmarks.delivery.application_manager import record_merge_latency
from benchmarks.measuring.comparisons import Comparison, staged
from benchmarks.registry.catalogue import record

PLANS = 50
ALLOWANCE_MS = 150.0
GOAL_MS = 300.0
SECONDS_MAX = 600


def measure() -> dict[str, list[float]]:
    """Milliseconds of each round, by what was measured."""
    return staged("delivery.manager.merge_latency", PLANS, SECONDS_MAX)


def p95(values: list[float]) -> float:
    """The value that 95 % do not exceed."""
    return sorted(values)[round(0.95 * (len(values) - 1))]


def compare() -> list[Comparison]:
    """Task to main against the forge alone."""
    milliseconds = measure()
    ours = statistics.median(milliseconds["tasks"])
    floor = p95(milliseconds["floor"])
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
