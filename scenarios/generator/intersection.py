"""A vehicle that passes a road-side unit: from beyond the start distance, along its lane, to beyond the stop distance.

The unit stands beside the road near the origin. A second vehicle, when there is one, waits on the other lane; further
ones take no part.
"""

from __future__ import annotations

import math

from scenarios.definition import Parameters, ScenarioError
from scenarios.generator.drives import (
    LANE_SEPARATION_M,
    LEAD_IN_SECONDS,
    TAIL_SECONDS,
    Floats,
    Motion,
    drive,
    standing,
    straight,
)

UNIT_Y_M = 9.0  # between the lanes and the walls
UNITS_SPACING_M = 10_000.0
WAITING_X_M = 25.0
NEAR_SECONDS_MIN = 30.0  # for an operator and then its services to be launched, and to work
PARTAKING = 2


def duration_seconds(parameters: Parameters) -> int:
    """Length of the run in whole seconds; refuses parameters that leave no time to launch a chain."""
    near = near_seconds(parameters)
    if near < NEAR_SECONDS_MIN:
        raise ScenarioError(
            f"parameters.speed_mps: {parameters.speed_mps:g}: the vehicle would be near for {near:.1f} s, and "
            f"{NEAR_SECONDS_MIN:g} s are needed; lower speed_mps or widen start_distance_m and stop_distance_m"
        )
    return math.ceil(LEAD_IN_SECONDS + near + TAIL_SECONDS)


def near_seconds(parameters: Parameters) -> float:
    """Time from the start distance, closing, to the stop distance, parting."""
    return (parameters.start_distance_m + parameters.stop_distance_m) / parameters.speed_mps


def motion(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Where player number `index` is at `times`: the first two vehicles, or a road-side unit behind all vehicles."""
    if index == 0:
        begin = -(parameters.start_distance_m + LEAD_IN_SECONDS * parameters.speed_mps)
        return drive((straight(TAIL_SECONDS, parameters.speed_mps, 1),), begin, times)
    if index < parameters.vehicles:
        return standing(WAITING_X_M, LANE_SEPARATION_M / 2, math.pi, times)
    return standing((index - parameters.vehicles) * UNITS_SPACING_M, UNIT_Y_M, 0.0, times)
