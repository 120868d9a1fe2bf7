"""Cores over time: the components that took the most, and all others together."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from scenarios.definition import Scenario
from scenarios.runner.inputs import NANOSECONDS, CoresUsed, RunInputs
from scenarios.runner.judging.encounters import Encounter
from scenarios.runner.reporting.series.thinning import groups

COMPONENTS_MAX = 7
OTHERS = "all others"
DIGITS = 4


def cores(_scenario: Scenario, inputs: RunInputs, _met: Sequence[Encounter]) -> dict[str, Any] | None:
    """`seconds` since the start, and by component the cores on average from each of them to the next; None when
    nobody sampled."""
    used = inputs.cores
    if used is None or not used.components or len(used.times) < 2:
        return None
    spans = [(group[0], group[-1] + 1) for group in groups(range(len(used.times) - 1))]
    bounds = [used.times[begin] for begin, _ in spans] + [used.times[-1]]
    ranked = sorted(used.components, key=lambda name: (-_core_seconds(used, used.components[name]), name))
    chosen = {name: used.components[name] for name in ranked[:COMPONENTS_MAX]}
    if len(ranked) > COMPONENTS_MAX:
        chosen[OTHERS] = _sum([used.components[name] for name in ranked[COMPONENTS_MAX:]])
    return {
        "seconds": [(moment - inputs.started) / NANOSECONDS for moment in bounds],
        "components": {name: [_average(used, values, span) for span in spans] for name, values in chosen.items()},
    }


def _core_seconds(used: CoresUsed, values: Sequence[float]) -> float:
    lengths = (end - begin for begin, end in pairwise(used.times))
    return sum(value * length for value, length in zip(values, lengths, strict=True))


def _sum(components: Sequence[Sequence[float]]) -> tuple[float, ...]:
    return tuple(sum(values) for values in zip(*components, strict=True))


def _average(used: CoresUsed, values: Sequence[float], span: tuple[int, int]) -> float:
    """The mean over the samples of a span, each by its length."""
    begin, end = span
    lengths = [used.times[n + 1] - used.times[n] for n in range(begin, end)]
    whole = sum(value * length for value, length in zip(values[begin:end], lengths, strict=True))
    return round(whole / max(1, sum(lengths)), DIGITS)
