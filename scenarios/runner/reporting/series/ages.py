"""Ages of the poses at the event detector's input: receive time minus header.stamp."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median_low
from typing import Any

from scenarios.definition import Scenario, pose_topic
from scenarios.runner.inputs import NANOSECONDS, InputCounters, RunInputs
from scenarios.runner.judging.encounters import Encounter
from scenarios.runner.judging.measures import pose_ages, same_process
from scenarios.runner.reporting.series.thinning import groups


def ages(scenario: Scenario, inputs: RunInputs, _met: Sequence[Encounter]) -> dict[str, Any] | None:
    """One histogram of the ages of all poses in whole ms, and p50 and p99 per second and vehicle; None when the
    counters do not cover the run."""
    after = same_process(inputs)
    counted = pose_ages(scenario, inputs)
    if after is None or counted is None:
        return None
    known = sorted(age for age, poses in counted.items() if poses > 0)
    return {
        "milliseconds": known,
        "poses": [counted[age] for age in known],
        "vehicles": dict(_vehicles(scenario, inputs, after)),
    }


def _vehicles(scenario: Scenario, inputs: RunInputs, after: InputCounters) -> Iterator[tuple[str, dict[str, Any]]]:
    first, last = inputs.started // NANOSECONDS, inputs.ended // NANOSECONDS
    for agent in scenario.vehicles:
        counts = after.topics.get(pose_topic(agent))
        quantiles = sorted(counts.age_quantiles_ms.items()) if counts else []
        mine = [(second - first, p50, p99) for second, (p50, p99) in quantiles if first <= second <= last]
        if mine:
            yield agent, _thinned(mine)


def _thinned(seconds: Sequence[tuple[int, int, int]]) -> dict[str, list[int]]:
    """At most as many values as a drawing shows: of neighbouring seconds the median p50 and the greatest p99."""
    chosen = list(groups(seconds))
    return {
        "seconds": [group[0][0] for group in chosen],
        "p50_ms": [median_low(p50 for _, p50, _ in group) for group in chosen],
        "p99_ms": [max(p99 for _, _, p99 in group) for group in chosen],
    }
