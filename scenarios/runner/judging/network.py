"""Judgement of cables: they were as a scenario asked, or not, by a probe before the run and by counters during it.
Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from scenarios.runner.inputs import NetworkOfRun, RunInputs

RATE_SHARE_MIN, RATE_SHARE_MAX = 0.8, 1.1
ROUND_TRIP_MORE_MS = 10.0  # what the machine itself adds
DEVIATIONS_MAX = 5.0  # of the number of lost packets, in standard deviations
HOLE_LATE_SECONDS_MAX = 0.5


def as_asked(inputs: RunInputs) -> bool | None:
    """Return whether every cable had the conditions that were asked for; None when none was asked for."""
    return not problems(inputs.cables) if inputs.cables else None


def problems(cables: Sequence[NetworkOfRun]) -> list[str]:
    """What of the cables was not as asked, in sentences."""
    return [f"network of {cable.agent}: {text}" for cable in cables for text in _problems(cable)]


def _problems(cable: NetworkOfRun) -> Iterator[str]:
    yield from _rates(cable)
    yield from _round_trip(cable)
    yield from _losses(cable)
    for hole in cable.holes:
        began = hole.began_seconds
        if began is None:
            yield f"its hole at {hole.at_seconds:g} s was not opened"
        elif abs(began - hole.at_seconds) > HOLE_LATE_SECONDS_MAX:
            yield f"its hole at {hole.at_seconds:g} s began at {began:.3f} s"
    if cable.holes and cable.traffic and not any(one.in_holes for one in cable.traffic.values()):
        yield "its holes dropped no packet"
    if cable.relay_dropped:
        yield f"the relay of all cables itself lost {cable.relay_dropped} packets, which nobody had asked for"


def _rates(cable: NetworkOfRun) -> Iterator[str]:
    for key in ("up_mbit", "down_mbit"):
        asked = cable.asked.get(key)
        rate = getattr(cable.measured, key) if cable.measured else None
        if asked and (rate is None or not RATE_SHARE_MIN <= rate / asked <= RATE_SHARE_MAX):
            shown = "nothing" if rate is None else f"{rate:.1f}"
            yield f"{key} {asked:g} was asked for, {shown} was measured"


def _round_trip(cable: NetworkOfRun) -> Iterator[str]:
    asked, jitter = cable.asked.get("round_trip_ms"), cable.asked.get("jitter_ms", 0.0)
    trip = cable.measured.round_trip_ms if cable.measured else None
    if asked and (trip is None or not asked - jitter <= trip[1] <= asked + jitter + ROUND_TRIP_MORE_MS):
        shown = "nothing" if trip is None else f"{trip[1]:.1f} in the median"
        yield f"round_trip_ms {asked:g} was asked for, {shown} was measured"


def _losses(cable: NetworkOfRun) -> Iterator[str]:
    chance = cable.asked.get("loss_percent", 0.0) / 100
    for direction, one in cable.traffic.items():
        carried = one.packets - one.in_holes
        expected = carried * chance
        if abs(one.lost - expected) > DEVIATIONS_MAX * math.sqrt(expected * (1 - chance)) + 1:
            yield f"{direction} {one.lost} of {carried} packets were lost, {expected:.0f} were to be expected"


def rows(cables: Sequence[NetworkOfRun]) -> list[Mapping[str, Any]]:
    """The cables by the names of the report."""
    return [_row(cable) for cable in cables]


def _row(cable: NetworkOfRun) -> Mapping[str, Any]:
    measured = asdict(cable.measured) if cable.measured else None
    if measured and measured["round_trip_ms"]:
        measured["round_trip_ms"] = dict(zip(("least", "median", "greatest"), measured["round_trip_ms"], strict=True))
    return {
        "agent": cable.agent,
        "asked": dict(cable.asked),
        "measured": measured,
        "packets": {direction: asdict(one) for direction, one in cable.traffic.items()},
        "holes": [asdict(hole) for hole in cable.holes],
        "acts": list(cable.acts),
    }
