"""A vehicle that passes a road-side unit: from beyond the start distance, along its lane, to beyond the stop distance.

The unit stands beside the road near the origin. A second vehicle, when there is one, waits on the other lane; further
ones take no part. With `blocked_seconds` it waits in the side street instead, behind a container at the corner: the
first vehicle, whose lidar sees only a little of it, stops before the corner for that long. The unit sees all of it.
"""

from __future__ import annotations

import math

from scenarios.definition import Parameters, ScenarioError
from scenarios.generator.drives import (
    ACCELERATION_MPS2,
    LANE_SEPARATION_M,
    LEAD_IN_SECONDS,
    TAIL_SECONDS,
    Floats,
    Motion,
    Phase,
    drive,
    standing,
    straight,
)
from scenarios.generator.scene import Obstacle, Place

UNIT_Y_M = 9.0  # between the lanes and the walls
UNITS_SPACING_M = 10_000.0
WAITING_X_M = 25.0
NEAR_SECONDS_MIN = 30.0  # for an operator and then its services to be launched, and to work
PARTAKING = 2
UNIT = Place(0.0, UNIT_Y_M, 0.0)
STOPPED = Place(-38.0, -LANE_SEPARATION_M / 2, 0.0)  # before the corner
HIDDEN = Place(-12.0, 12.0, -math.pi / 2)  # in the side street, where the walls have a gap
CONTAINER = Obstacle(Place(-21.6, 9.0, 0.0), (12.2, 2.4, 2.6))  # one of forty feet


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
    driving = (parameters.start_distance_m + parameters.stop_distance_m) / parameters.speed_mps
    lost = parameters.speed_mps / ACCELERATION_MPS2  # half of it while braking, half while starting
    return driving + (lost + parameters.blocked_seconds if parameters.blocked_seconds else 0.0)


def obstacles(parameters: Parameters) -> tuple[Obstacle, ...]:
    """What stands in the way of the lidars' rays."""
    return (CONTAINER,) if parameters.blocked_seconds else ()


def motion(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Motion of player number `index` at `times`: the first two vehicles, or a road-side unit behind all vehicles."""
    if index == 0:
        begin = -(parameters.start_distance_m + LEAD_IN_SECONDS * parameters.speed_mps)
        return drive(_phases(parameters, begin), begin, times)
    if index < parameters.vehicles:
        waiting = HIDDEN if parameters.blocked_seconds else Place(WAITING_X_M, LANE_SEPARATION_M / 2, math.pi)
        return standing(waiting.x, waiting.y, waiting.yaw, times)
    return standing((index - parameters.vehicles) * UNITS_SPACING_M, UNIT_Y_M, 0.0, times)


def _phases(parameters: Parameters, begin: float) -> list[Phase]:
    """The drive of the first vehicle from x = `begin`: straight on, or with a stop before the corner."""
    speed = parameters.speed_mps
    onwards = straight(TAIL_SECONDS, parameters.speed_mps, 1)
    if not parameters.blocked_seconds:
        return [onwards]
    braking = Phase(speed / ACCELERATION_MPS2, speed, 0.0, False, 1)
    way = STOPPED.x - braking.length - begin
    if way < 0:
        raise ScenarioError(
            f"parameters.speed_mps: {speed:g}: the vehicle cannot stop before the corner, {-way:.0f} m are missing; "
            "lower speed_mps or widen start_distance_m"
        )
    starting = Phase(braking.seconds, 0.0, speed, False, 1)
    return [straight(way / speed, speed, 1), braking, straight(parameters.blocked_seconds, 0.0, 1), starting, onwards]
