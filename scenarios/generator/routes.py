"""Routes: where every player is at every moment. Which drives are made is the parameter `routes`:

`pair`: two vehicles meet and part as often as asked. They drive on the two lanes of one straight road, pass, slow down,
turn around and come back. Vehicle 01 is vehicle 00 turned by half a turn about the origin, so their distance is twice
the distance of either from it. `three-vehicles`, `intersection`: see there. Vehicles that take no part are far away.
All lengths in m, times in s from the start of the run, angles in rad.
"""

from __future__ import annotations

import math

import numpy as np

from scenarios.definition import Parameters, ScenarioError
from scenarios.generator import intersection, three_vehicles
from scenarios.generator.drives import (
    APART_SECONDS,
    LEAD_IN_SECONDS,
    TAIL_SECONDS,
    TURN_SECONDS,
    Floats,
    Motion,
    Phase,
    around,
    braking_seconds,
    distance,
    drive,
    opposite,
    straight,
)
from scenarios.generator.scene import Obstacle

__all__ = ["Motion", "distance", "duration_seconds", "encounter_seconds", "motion", "obstacles"]

ENCOUNTER_SECONDS_MIN = 20.0  # 8 to deploy, 12 to record
OTHERS_SPACING_M = 150.0
PAIR, THREE_VEHICLES, INTERSECTION = "pair", "three-vehicles", "intersection"


def duration_seconds(parameters: Parameters) -> int:
    """Length of the run in whole seconds; refuses parameters that leave no time for its story."""
    if parameters.routes == THREE_VEHICLES:
        return three_vehicles.duration_seconds(parameters)
    if parameters.routes == INTERSECTION:
        return intersection.duration_seconds(parameters)
    return _pair_seconds(parameters)


def motion(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Positions of player number `index` at `times`: vehicles, then road-side units."""
    if parameters.routes == THREE_VEHICLES and index < three_vehicles.VEHICLES:
        return three_vehicles.motion(parameters, index, times)
    if parameters.routes == INTERSECTION and not intersection.PARTAKING <= index < parameters.vehicles:
        return intersection.motion(parameters, index, times)
    if parameters.routes == PAIR and index < 2:
        first = drive(_phases(parameters), -(parameters.start_distance_m / 2 + _lead_in_m(parameters)), times)
        return opposite(first) if index else first
    return _circling(parameters, index, times)


def obstacles(parameters: Parameters) -> tuple[Obstacle, ...]:
    """What stands in the way of the lidars' rays besides walls and vehicles."""
    return intersection.obstacles(parameters) if parameters.routes == INTERSECTION else ()


def _lead_in_m(parameters: Parameters) -> float:
    return LEAD_IN_SECONDS * parameters.speed_mps


def _pair_seconds(parameters: Parameters) -> int:
    together = encounter_seconds(parameters)
    if together < ENCOUNTER_SECONDS_MIN:
        raise ScenarioError(
            f"parameters.speed_mps: {parameters.speed_mps:g}: an encounter would last {together:.1f} s, and "
            f"{ENCOUNTER_SECONDS_MIN:g} s are "
            "needed to deploy and record; lower speed_mps or widen start_distance_m and stop_distance_m"
        )
    return math.ceil(sum(phase.seconds for phase in _phases(parameters)))


def encounter_seconds(parameters: Parameters) -> float:
    """Time that the pair is near: from the start distance, closing, to the stop distance, parting."""
    return (parameters.start_distance_m + parameters.stop_distance_m) / (2 * parameters.speed_mps)


def _phases(parameters: Parameters) -> list[Phase]:
    """The drive of vehicle 00, from its start to the end of the run (one second longer, to be cut)."""
    speed = parameters.speed_mps
    coasting = max(0.0, APART_SECONDS - 2 * braking_seconds(speed) - TURN_SECONDS) / 2
    together = encounter_seconds(parameters)
    closing = (parameters.stop_distance_m - parameters.start_distance_m) / (2 * speed)
    phases = [straight(LEAD_IN_SECONDS + together, speed, 1)]
    direction = 1
    for _ in range(parameters.encounters - 1):
        phases += [
            straight(coasting, speed, direction),
            *around(speed, direction),
            straight(coasting + closing + together, speed, -direction),
        ]
        direction = -direction
    return [*phases, straight(TAIL_SECONDS, speed, direction)]


def _circling(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Vehicles that take no part drive in circles, more than twice the stop distance off the road."""
    radius, speed = 50.0 + 2.0 * index, 8.0 + 0.25 * index
    column, row = index % 8, index // 8
    centre_x = (column - 3.5) * OTHERS_SPACING_M * 2
    centre_y = 2 * parameters.stop_distance_m + 500.0 + 2 * OTHERS_SPACING_M * row
    angle = speed / radius * times + index
    return Motion(centre_x + radius * np.cos(angle), centre_y + radius * np.sin(angle), angle + math.pi / 2)
