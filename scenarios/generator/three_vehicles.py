"""Three that meet in turn: vehicle 01 stands at the origin; 00 comes from one side, turns around and leaves, 02 does
the same on the other side while 00 is still near, and 00 comes once more when 02 has left.

00 and 02 turn around so early that they are never near each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from scenarios.definition import Parameters, ScenarioError
from scenarios.generator.drives import (
    APART_SECONDS,
    LEAD_IN_SECONDS,
    TAIL_SECONDS,
    TURN_SECONDS,
    Floats,
    Motion,
    Phase,
    around,
    braking_length,
    braking_seconds,
    drive,
    opposite,
    standing,
    straight,
)

VEHICLES = 3
TURN_MARGIN_M = 20.0
VISIT_SECONDS_MIN = 24.0  # half of it the encounters overlap, and half of it each lasts alone: 12 s to see both


def duration_seconds(parameters: Parameters) -> int:
    """Length of the run in whole seconds; refuses parameters that leave no time for an overlap."""
    visit = visit_seconds(parameters)
    if visit < VISIT_SECONDS_MIN or _approach(parameters, parameters.start_distance_m) < 0:
        raise ScenarioError(
            f"parameters.speed_mps: {parameters.speed_mps:g}: an encounter would last {visit:.1f} s, and "
            f"{VISIT_SECONDS_MIN:g} s are needed so that two overlap; lower speed_mps or widen start_distance_m and "
            "stop_distance_m"
        )
    return math.ceil(sum(phase.seconds for phase in _first(parameters)))


def visit_seconds(parameters: Parameters) -> float:
    """Time of an encounter: from the start distance to the turn and back to the stop distance."""
    ways = (_approach(parameters, limit) for limit in (parameters.start_distance_m, parameters.stop_distance_m))
    return sum(ways) + 2 * braking_seconds(parameters.speed_mps) + TURN_SECONDS


def motion(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Positions of vehicle number 0, 1 or 2 at `times`."""
    lead_in = LEAD_IN_SECONDS * parameters.speed_mps
    if index == 0:
        return drive(_first(parameters), -(parameters.start_distance_m + lead_in), times)
    if index == 1:
        return standing(0.0, 0.0, 0.0, times)
    later = _later(parameters)
    begin = -(parameters.start_distance_m + lead_in + later * parameters.speed_mps)
    return opposite(drive(_third(parameters, later), begin, times))


def _later(parameters: Parameters) -> float:
    """How long after the first encounter the second begins."""
    return visit_seconds(parameters) / 2


def _approach(parameters: Parameters, limit: float) -> float:
    """Time at full speed between a distance and the place where braking for the turn begins."""
    turn = parameters.start_distance_m / 2 + TURN_MARGIN_M
    return (limit - turn - braking_length(parameters.speed_mps)) / parameters.speed_mps


def _first(parameters: Parameters) -> Sequence[Phase]:
    """Near, away, and when the third has left near and away again."""
    speed = parameters.speed_mps
    braking = braking_seconds(parameters.speed_mps)
    inward, outward = (_approach(parameters, m) for m in (parameters.start_distance_m, parameters.stop_distance_m))
    closing = (parameters.stop_distance_m - parameters.start_distance_m) / speed
    coasting = max(0.0, _later(parameters) + APART_SECONDS - 2 * braking - TURN_SECONDS - closing) / 2
    return (
        straight(LEAD_IN_SECONDS + inward, speed, 1),
        *around(speed, 1),
        straight(outward + coasting, speed, -1),
        *around(speed, -1),
        straight(coasting + closing + inward, speed, 1),
        *around(speed, 1),
        straight(outward + TAIL_SECONDS, speed, -1),
    )


def _third(parameters: Parameters, later: float) -> Sequence[Phase]:
    speed = parameters.speed_mps
    inward = _approach(parameters, parameters.start_distance_m)
    return (straight(LEAD_IN_SECONDS + later + inward, speed, 1), *around(speed, 1), straight(TAIL_SECONDS, speed, -1))
