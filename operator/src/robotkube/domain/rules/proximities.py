"""Which agents are near each other, by a grid: of a thousand agents each is compared with its neighbours only."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor
from operator import attrgetter

from robotkube.domain.rules.conditions import Condition
from robotkube.domain.rules.edges import Cause
from robotkube.domain.rules.messages import FALL, RISE, Finding, Reading, pair
from robotkube.domain.rules.specifications import Proximity

POSITION_MAX = 1e12

_name = attrgetter("agent")

Cell = tuple[int, int]


@dataclass(slots=True)
class _Place:
    """Where an agent is; changed in place, because everybody around looks at it. `around`: who stands in its cell and
    the eight next to it, itself included."""

    agent: str
    stamp: int
    x: float
    y: float
    z: float
    topic: str
    cell: Cell
    around: dict[str, _Place]


class ProximityCondition(Condition):
    """Latest position per agent in square cells as wide as the start distance, and the partners of who is near.

    Whoever is nearer than the start distance stands in one of the nine cells around; whoever was near is compared
    until he is farther than the stop distance, wherever he stands. The stamp of a finding is the later of the two.
    Each cell knows who stands around it: agents send much more often than they change their cell.
    """

    def __init__(self, settings: Proximity) -> None:
        super().__init__()
        self._settings = settings
        self._stale_ns = int(settings.stale_seconds * 1e9)
        self._width = settings.start_distance_m
        self._start_squared, self._stop_squared = settings.start_distance_m**2, settings.stop_distance_m**2
        self._places: dict[str, _Place] = {}
        self._around: dict[Cell, dict[str, _Place]] = {}

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """See the base; the values are x, y and z in metres."""
        place = self._put(reading)
        found: list[Finding] = []
        if len(place.around) > 1:
            found = [self._finding(reading, place, other, RISE) for other in self._near(place)]
        if self.paired:
            for agent in self.partners(place.agent):
                known = self._places.get(agent)
                if known is not None and self._comparable(place, known) and _squared(place, known) > self._stop_squared:
                    found.append(self._finding(reading, place, known, FALL))
        return found

    def forget(self, agent: str) -> None:
        """See the base."""
        place = self._places.pop(agent, None)
        if place is not None:
            self._leave(place)

    def _near(self, place: _Place) -> list[_Place]:
        """Who has come near, by name, so that the order does not depend on who came first into which cell."""
        found, holding = [], self.holding
        x, y, z, limit = place.x, place.y, place.z, self._start_squared
        for other in place.around.values():
            across, along, up = x - other.x, y - other.y, z - other.z
            if across * across + along * along + up * up >= limit or other is place:
                continue
            if self._comparable(place, other) and pair(place.agent, other.agent) not in holding:
                found.append(other)
        return sorted(found, key=_name) if len(found) > 1 else found

    def _put(self, reading: Reading) -> _Place:
        topic, agent, stamp, _, (x, y, z), _, _ = reading
        most = POSITION_MAX
        if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
            raise ValueError(f"{self._settings.position} is no position")
        cell = floor(x / self._width), floor(y / self._width)
        place = self._places.get(agent)
        if place is None:
            place = self._places[agent] = _Place(agent, stamp, x, y, z, topic, cell, {})
            self._enter(place)
        else:
            place.stamp, place.x, place.y, place.z, place.topic = stamp, x, y, z, topic
            if place.cell != cell:
                self._leave(place)
                place.cell = cell
                self._enter(place)
        return place

    def _enter(self, place: _Place) -> None:
        for cell in _nine(place.cell):
            self._around.setdefault(cell, {})[place.agent] = place
        place.around = self._around[place.cell]

    def _leave(self, place: _Place) -> None:
        for cell in _nine(place.cell):
            inhabitants = self._around[cell]
            del inhabitants[place.agent]
            if not inhabitants:
                del self._around[cell]

    def _comparable(self, one: _Place, other: _Place) -> bool:
        return abs(one.stamp - other.stamp) <= self._stale_ns

    def _finding(self, reading: Reading, mine: _Place, theirs: _Place, verdict: int) -> Finding:
        distance = math.sqrt(_squared(mine, theirs))
        causes = (self._cause(mine), self._cause(theirs))
        stamp = max(mine.stamp, theirs.stamp)
        member = pair(mine.agent, theirs.agent)
        return Finding(member, verdict, stamp, reading.received, {"distance_m": distance}, causes)

    def _cause(self, place: _Place) -> Cause:
        path = self._settings.position
        return Cause(place.topic, place.stamp, {f"{path}.x": place.x, f"{path}.y": place.y, f"{path}.z": place.z})


def _squared(one: _Place, other: _Place) -> float:
    return (one.x - other.x) ** 2 + (one.y - other.y) ** 2 + (one.z - other.z) ** 2


def _nine(cell: Cell) -> Iterator[Cell]:
    column, row = cell
    return ((column + right, row + up) for right in (-1, 0, 1) for up in (-1, 0, 1))
