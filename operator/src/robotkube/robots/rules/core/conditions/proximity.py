"""The condition that two agents are near each other, by a grid: each agent is compared with its neighbours only."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor
from operator import attrgetter

from robotkube.robots.rules.core.conditions.levels import RuleCondition
from robotkube.robots.rules.core.conditions.pairs import ApartPairs
from robotkube.robots.rules.core.events import Cause
from robotkube.robots.rules.core.messages import FALL, RISE, MemberChange, MessageValues, NoNumberError, pair
from robotkube.robots.rules.core.specification.specifications import Proximity

FINITE_MAX = sys.float_info.max

_name = attrgetter("agent")

Cell = tuple[int, int]

FAR_CELL: Cell = (0, 0)
"""The cell of what is so far out that its own has no number."""


@dataclass(slots=True)
class _Place:
    """The place of an agent; changed in place, because all neighbours share it. `around`: the places in its cell and
    the eight next to it, itself included."""

    agent: str
    stamp: int
    received: int
    x: float
    y: float
    z: float
    topic: str
    cell: Cell
    around: dict[str, _Place]


class ProximityCondition(RuleCondition):
    """The condition of nearness: latest positions in square cells as wide as the start distance, and pairs that are
    near.

    Whoever is nearer than the start distance stands in one of the nine cells around; whoever was near is compared
    until he is farther than the stop distance, wherever he stands. The stamp of a change is the later of the two.
    Each cell knows who stands around it: agents send much more often than they change their cell.
    """

    def __init__(self, settings: Proximity) -> None:
        super().__init__()
        self._settings = settings
        self._stale_ns = int(settings.stale_seconds * 1e9)
        self._width = settings.start_distance_m
        self._start_squared = settings.start_distance_m**2
        self.apart: ApartPairs = ApartPairs(self._stale_ns)
        self._places: dict[str, _Place] = {}
        self._around: dict[Cell, dict[str, _Place]] = {}

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """See the base; the values are x, y and z in metres."""
        place = self._put(reading)
        changes: list[MemberChange] = []
        if len(place.around) > 1:
            changes = [self._member_change(reading, place, other, RISE) for other in self._near(place)]
        if self.paired:
            for agent in self.partners(place.agent):
                known = self._places.get(agent)
                if known is None:
                    continue
                if self._comparable(place, known) and _distance(place, known) > self._settings.stop_distance_m:
                    changes.append(self._member_change(reading, place, known, FALL))
        return changes

    def forget(self, agent: str) -> None:
        """See the base."""
        place = self._places.pop(agent, None)
        if place is not None:
            self._leave(place)

    def _near(self, place: _Place) -> list[_Place]:
        """The places that have come near, by name, so that the order does not depend on who came first into which
        cell."""
        near = []
        holding = self.holding
        x, y, z = place.x, place.y, place.z
        limit = self._start_squared
        for other in place.around.values():
            across, along, up = x - other.x, y - other.y, z - other.z
            if across * across + along * along + up * up >= limit or other is place:
                continue
            if pair(place.agent, other.agent) not in holding and self._comparable(place, other):
                near.append(other)
        return sorted(near, key=_name) if len(near) > 1 else near

    def _put(self, reading: MessageValues) -> _Place:
        topic, agent, stamp, received, (x, y, z), _, _ = reading
        most = FINITE_MAX
        if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
            raise NoNumberError(f"{self._settings.position} is no position")
        try:
            cell = floor(x / self._width), floor(y / self._width)
        except OverflowError:  # so far out two numbers are the same, or farther apart than any bound
            cell = FAR_CELL
        place = self._places.get(agent)
        if place is None:
            place = self._places[agent] = _Place(agent, stamp, received, x, y, z, topic, cell, {})
            self._enter(place)
        else:
            place.stamp = stamp
            place.received = received
            place.x = x
            place.y = y
            place.z = z
            place.topic = topic
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

    def _comparable(self, place: _Place, other: _Place) -> bool:
        if abs(place.stamp - other.stamp) <= self._stale_ns:
            return True
        self.apart.note(place.agent, place.stamp, place.received, other.agent, other.stamp, other.received)
        return False

    def _member_change(self, reading: MessageValues, mine: _Place, theirs: _Place, verdict: int) -> MemberChange:
        distance = min(_distance(mine, theirs), FINITE_MAX)
        causes = (self._cause(mine), self._cause(theirs))
        stamp = max(mine.stamp, theirs.stamp)
        member = pair(mine.agent, theirs.agent)
        return MemberChange(member, verdict, stamp, reading.received, {"distance_m": distance}, causes)

    def _cause(self, place: _Place) -> Cause:
        path = self._settings.position
        return Cause(place.topic, place.stamp, {f"{path}.x": place.x, f"{path}.y": place.y, f"{path}.z": place.z})


def _distance(place: _Place, other: _Place) -> float:
    return math.hypot(place.x - other.x, place.y - other.y, place.z - other.z)


def _nine(cell: Cell) -> Iterator[Cell]:
    column, row = cell
    return ((column + right, row + up) for right in (-1, 0, 1) for up in (-1, 0, 1))
