"""Which agents are near each other, by a grid: of a thousand agents each is compared with its neighbours only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from robotkube.domain.rules.conditions import Condition
from robotkube.domain.rules.edges import Cause
from robotkube.domain.rules.messages import FALL, RISE, Finding, Reading, pair
from robotkube.domain.rules.specifications import Proximity

POSITION_MAX = 1e12

Cell = tuple[int, int]


class _Place(NamedTuple):
    stamp: int
    x: float
    y: float
    z: float
    topic: str
    cell: Cell


class ProximityCondition(Condition):
    """Latest position per agent in square cells as wide as the start distance, and the partners of who is near.

    Whoever is nearer than the start distance stands in one of the nine cells around; whoever was near is compared
    until he is farther than the stop distance, wherever he stands. The stamp of a finding is the later of the two.
    """

    def __init__(self, settings: Proximity) -> None:
        super().__init__()
        self._settings = settings
        self._stale_ns = int(settings.stale_seconds * 1e9)
        self._start_squared, self._stop_squared = settings.start_distance_m**2, settings.stop_distance_m**2
        self._places: dict[str, _Place] = {}
        self._cells: dict[Cell, dict[str, _Place]] = {}

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """See the base; the values are x, y and z in metres."""
        place = self._put(reading)
        agent, found, holding = reading.agent, [], self.holding
        column, row = place.cell
        for cell in (
            (column, row), (column - 1, row), (column + 1, row), (column, row - 1), (column, row + 1),
            (column - 1, row - 1), (column - 1, row + 1), (column + 1, row - 1), (column + 1, row + 1),
        ):  # fmt: skip
            for other, theirs in self._cells.get(cell, {}).items():
                squared = (place.x - theirs.x) ** 2 + (place.y - theirs.y) ** 2 + (place.z - theirs.z) ** 2
                if squared >= self._start_squared or other == agent or not self._comparable(place, theirs):
                    continue
                if pair(agent, other) not in holding:
                    found.append(self._finding(reading, place, other, theirs, RISE))
        for other in self.partners(agent):
            known = self._places.get(other)
            if known is not None and self._comparable(place, known) and _squared(place, known) > self._stop_squared:
                found.append(self._finding(reading, place, other, known, FALL))
        return found

    def forget(self, agent: str) -> None:
        """See the base."""
        place = self._places.pop(agent, None)
        if place is not None:
            self._leave(agent, place.cell)

    def _put(self, reading: Reading) -> _Place:
        x, y, z = reading.values
        if not (abs(x) <= POSITION_MAX and abs(y) <= POSITION_MAX and abs(z) <= POSITION_MAX):
            raise ValueError(f"{self._settings.position} is no position")
        width = self._settings.start_distance_m
        cell = math.floor(x / width), math.floor(y / width)
        agent, before = reading.agent, self._places.get(reading.agent)
        if before is not None and before.cell != cell:
            self._leave(agent, before.cell)
        place = self._places[agent] = _Place(reading.stamp, x, y, z, reading.topic, cell)
        self._cells.setdefault(cell, {})[agent] = place
        return place

    def _leave(self, agent: str, cell: Cell) -> None:
        inhabitants = self._cells[cell]
        del inhabitants[agent]
        if not inhabitants:
            del self._cells[cell]

    def _comparable(self, one: _Place, other: _Place) -> bool:
        return abs(one.stamp - other.stamp) <= self._stale_ns

    def _finding(self, reading: Reading, mine: _Place, other: str, theirs: _Place, verdict: int) -> Finding:
        distance = math.sqrt(_squared(mine, theirs))
        causes = (self._cause(mine), self._cause(theirs))
        stamp = max(mine.stamp, theirs.stamp)
        member = pair(reading.agent, other)
        return Finding(member, verdict, stamp, reading.received, {"distance_m": distance}, causes)

    def _cause(self, place: _Place) -> Cause:
        path = self._settings.position
        return Cause(place.topic, place.stamp, {f"{path}.x": place.x, f"{path}.y": place.y, f"{path}.z": place.z})


def _squared(one: _Place, other: _Place) -> float:
    return (one.x - other.x) ** 2 + (one.y - other.y) ** 2 + (one.z - other.z) ** 2
