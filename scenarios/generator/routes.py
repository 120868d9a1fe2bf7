"""Where every vehicle is at every moment: two that meet and part as often as asked, the others far away.

The pair drives on the two lanes of one straight road (x axis), passes, slows down, turns around and comes back.
Vehicle 01 is
vehicle 00 turned by half a turn about the origin, so their distance is twice the distance of either from it.
All lengths in m, times in s from the start of the run, angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.definition import Parameters, ScenarioError

LANE_SEPARATION_M = 8.0
ACCELERATION_MPS2 = 4.0
TURN_SPEED_MPS = 4.0
LEAD_IN_SECONDS = 5.0  # from the start of the run to the first event
APART_SECONDS = 16.5  # beyond the stop distance between two encounters: a removal may take 12
TAIL_SECONDS = 18.0  # driven on after the last stop, so that the removal is seen while data still flow
ENCOUNTER_SECONDS_MIN = 20.0  # 8 to deploy, 12 to record
OTHERS_SPACING_M = 150.0

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A vehicle's path sampled at given times: positions in frame `map` (z is 0) and heading, arrays of one length."""

    x: Floats
    y: Floats
    yaw: Floats


@dataclass(frozen=True)
class _Phase:
    """A stretch of the pair's drive: along a lane (`direction` +1 or -1 in x) or through a turn, speed linear in
    time."""

    seconds: float
    speed_before: float
    speed_after: float
    turning: bool
    direction: int

    @property
    def length(self) -> float:
        return self.seconds * (self.speed_before + self.speed_after) / 2


def duration_seconds(parameters: Parameters) -> int:
    """Length of the run in whole seconds; refuses parameters that leave no time to record."""
    together = encounter_seconds(parameters)
    if together < ENCOUNTER_SECONDS_MIN:
        raise ScenarioError(
            f"parameters.speed_mps: {parameters.speed_mps:g}: an encounter would last {together:.1f} s, and "
            f"{ENCOUNTER_SECONDS_MIN:g} s are "
            "needed to deploy and record; lower speed_mps or widen start_distance_m and stop_distance_m"
        )
    return math.ceil(sum(phase.seconds for phase in _phases(parameters)))


def encounter_seconds(parameters: Parameters) -> float:
    """Time from the start distance, closing, to the stop distance, parting."""
    return (parameters.start_distance_m + parameters.stop_distance_m) / (2 * parameters.speed_mps)


def motion(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Where vehicle number `index` is at `times`."""
    if index == 0:
        return _pair(parameters, times)
    if index == 1:
        first = _pair(parameters, times)
        return Motion(-first.x, -first.y, first.yaw + math.pi)
    return _circling(parameters, index, times)


def _phases(parameters: Parameters) -> list[_Phase]:
    """The drive of vehicle 00, from its start to the end of the run (one second longer, to be cut)."""
    speed = parameters.speed_mps
    braking = (speed - TURN_SPEED_MPS) / ACCELERATION_MPS2
    turn = math.pi * LANE_SEPARATION_M / 2 / TURN_SPEED_MPS
    coasting = max(0.0, APART_SECONDS - 2 * braking - turn) / 2
    together = encounter_seconds(parameters)
    closing = (parameters.stop_distance_m - parameters.start_distance_m) / (2 * speed)
    phases = [_Phase(LEAD_IN_SECONDS + together, speed, speed, False, 1)]
    direction = 1
    for _ in range(parameters.encounters - 1):
        phases += [
            _Phase(coasting, speed, speed, False, direction),
            _Phase(braking, speed, TURN_SPEED_MPS, False, direction),
            _Phase(turn, TURN_SPEED_MPS, TURN_SPEED_MPS, True, direction),
            _Phase(braking, TURN_SPEED_MPS, speed, False, -direction),
            _Phase(coasting + closing + together, speed, speed, False, -direction),
        ]
        direction = -direction
    return [*phases, _Phase(TAIL_SECONDS, speed, speed, False, direction)]


def _pair(parameters: Parameters, times: Floats) -> Motion:
    """Samples the drive of vehicle 00 phase by phase."""
    radius = LANE_SEPARATION_M / 2
    x, y, yaw = np.empty_like(times), np.empty_like(times), np.empty_like(times)
    begin, place = 0.0, -(parameters.start_distance_m / 2 + LEAD_IN_SECONDS * parameters.speed_mps)
    phases = _phases(parameters)
    for number, phase in enumerate(phases):
        last = number == len(phases) - 1
        chosen = (times >= begin) & (last | (times < begin + phase.seconds))
        since = times[chosen] - begin
        slope = (phase.speed_after - phase.speed_before) / phase.seconds if phase.seconds else 0.0
        way = phase.speed_before * since + slope / 2 * since**2
        straight_yaw = 0.0 if phase.direction > 0 else math.pi
        if phase.turning:
            angle = way / radius
            x[chosen] = place + phase.direction * radius * np.sin(angle)
            y[chosen] = -phase.direction * radius * np.cos(angle)
            yaw[chosen] = straight_yaw + angle
        else:
            x[chosen] = place + phase.direction * way
            y[chosen] = -phase.direction * radius
            yaw[chosen] = straight_yaw
            place += phase.direction * phase.length
        begin += phase.seconds
    return Motion(x, y, yaw)


def _circling(parameters: Parameters, index: int, times: Floats) -> Motion:
    """Vehicles that take no part drive in circles, more than twice the stop distance off the road."""
    radius, speed = 50.0 + 2.0 * index, 8.0 + 0.25 * index
    column, row = index % 8, index // 8
    centre_x = (column - 3.5) * OTHERS_SPACING_M * 2
    centre_y = 2 * parameters.stop_distance_m + 500.0 + 2 * OTHERS_SPACING_M * row
    angle = speed / radius * times + index
    return Motion(centre_x + radius * np.cos(angle), centre_y + radius * np.sin(angle), angle + math.pi / 2)


def distance(first: Motion, second: Motion) -> Floats:
    """Distance in m of two vehicles at each sampled time."""
    return np.hypot(first.x - second.x, first.y - second.y)
