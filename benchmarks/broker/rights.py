"""How soon a merged link is a right at the broker, and a withdrawn one none any more, against the forge alone.

The forge's part is from the push of main until its webhook arrives, in the same rounds: earlier nobody can know of the
merge. Writes `rights_applied_ms`, `rights_ended_ms`, `rights_announced_ms` (the forge's part) and `rights_own_ms` (the
rest) to build/bench/links.json. Where the forge's part alone leaves no room for the goal, it is that and ALLOWANCE_MS.
"""

from __future__ import annotations

from dataclasses import asdict

from benchmarks.broker.links import RECORD
from benchmarks.measuring.comparisons import Comparison, quantiles, record, staged

ROUNDS = 20
GOAL_MS = 1000.0
ALLOWANCE_MS = 500.0
SECONDS_MAX = 600


def measure(count: int = ROUNDS) -> dict[str, list[float]]:
    """Milliseconds of each round, by what was measured."""
    return staged("delivery.rights.rights_latency", count, SECONDS_MAX)


def compare() -> list[Comparison]:
    """Both against the forge's part, and what comes after it against the goal."""
    quantiles_of = {name: quantiles(values) for name, values in measure().items()}
    record(RECORD, {f"rights_{name}_ms": asdict(values) for name, values in quantiles_of.items()})
    floor = quantiles_of["announced"].p95
    bound = max(GOAL_MS, floor + ALLOWANCE_MS) / floor
    baseline = "push until the forge's webhook, p95"
    return [
        Comparison("merged link at the broker, p95", "ms", quantiles_of["applied"].p95, floor, bound, baseline),
        Comparison("withdrawn link's end, p95", "ms", quantiles_of["ended"].p95, floor, bound, baseline),
        Comparison("announced link at the broker, p95", "ms", quantiles_of["own"].p95, GOAL_MS, 1.0, "the goal"),
    ]
