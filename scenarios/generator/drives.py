"""Drives along the two lanes of a straight road (x axis), in phases: straight on, slower, around, back.

All lengths in m, times in s from the start of the run, angles in rad. Traffic keeps to the right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LANE_SEPARATION_M = 8.0
ACCELERATION_MPS2 = 4.0
TURN_SPEED_MPS = 4.0
LEAD_IN_SECONDS = 5.0  # from the start of the run to the first event
APART_SECONDS = 16.5  # beyond the stop distance between two encounters: a removal may take 12
TAIL_SECONDS = 18.0  # driven on after the last stop, so that the removal is seen while data still flow
TURN_SECONDS = math.pi * LANE_SEPARATION_M / 2 / TURN_SPEED_MPS

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A path sampled at given times: positions in frame `map` (z is 0) and heading, arrays of one length."""

    x: Floats
    y: Floats
    yaw: Floats


@dataclass(frozen=True)
class Phase:
    """A stretch of a drive: along a lane (`direction` +1 or -1 in x) or through a turn, speed linear in time."""

    seconds: float
    speed_before: float
    speed_after: float
    turning: bool
    direction: int

    @property
    def length(self) -> float:
        """The way it takes."""
        return self.seconds * (self.speed_before + self.speed_after) / 2


def straight(seconds: float, speed: float, direction: int) -> Phase:
    """Along a lane at one speed."""
    return Phase(seconds, speed, speed, False, direction)


def around(speed: float, direction: int) -> tuple[Phase, Phase, Phase]:
    """Slow down from `speed` on the lane of `direction`, turn, and take up speed on the other."""
    seconds = braking_seconds(speed)
    return (
        Phase(seconds, speed, TURN_SPEED_MPS, False, direction),
        Phase(TURN_SECONDS, TURN_SPEED_MPS, TURN_SPEED_MPS, True, direction),
        Phase(seconds, TURN_SPEED_MPS, speed, False, -direction),
    )


def braking_seconds(speed: float) -> float:
    """Time from `speed` to that of a turn."""
    return (speed - TURN_SPEED_MPS) / ACCELERATION_MPS2


def braking_length(speed: float) -> float:
    """Way from `speed` to that of a turn."""
    return braking_seconds(speed) * (speed + TURN_SPEED_MPS) / 2


def drive(phases: Sequence[Phase], place: float, times: Floats) -> Motion:
    """Samples a drive that begins at x = `place`, phase by phase; the last one lasts for ever."""
    radius = LANE_SEPARATION_M / 2
    x, y, yaw = np.empty_like(times), np.empty_like(times), np.empty_like(times)
    begin = 0.0
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


def standing(x: float, y: float, yaw: float, times: Floats) -> Motion:
    """Somebody who does not move."""
    return Motion(np.full_like(times, x), np.full_like(times, y), np.full_like(times, yaw))


def opposite(motion: Motion) -> Motion:
    """The same, turned by half a turn about the origin."""
    return Motion(-motion.x, -motion.y, motion.yaw + math.pi)


def distance(first: Motion, second: Motion) -> Floats:
    """Distance in m at each sampled time."""
    return np.hypot(first.x - second.x, first.y - second.y)
