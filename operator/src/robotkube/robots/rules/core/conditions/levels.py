"""The base of conditions, and conditions on one number or position: they give a change when they begin or cease to
hold.

Changes are changes only: `holding` has the members for whom it holds; the caller marks them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from math import isfinite

from robotkube.robots.rules.core.conditions.pairs import ApartPairs
from robotkube.robots.rules.core.events import Cause
from robotkube.robots.rules.core.messages import FALL, KEEP, RISE, Member, MemberChange, MessageValues, NoNumberError
from robotkube.robots.rules.core.specification.areas import Area
from robotkube.robots.rules.core.specification.specifications import Geofence, Level, Threshold

GRACE_NS = 100_000_000
"""The time by which a moment is judged later than it was due, because messages take their time."""


def earliest(moments: Iterable[int | None]) -> int | None:
    """The first of the moments; None when there is none."""
    first = None
    for moment in moments:
        if moment is not None and (first is None or moment < first):
            first = moment
    return first


class Timers:
    """Timers of members by this machine's clock (ns).

    `deadline` gives a member's moment anew when it has come, for it may have moved on; None ends the timer.
    """

    def __init__(self, deadline: Callable[[Member], int | None]) -> None:
        self._deadline = deadline
        self._heap: list[tuple[int, Member]] = []
        self._earliest: dict[Member, int] = {}

    def watch(self, member: Member, moment: int) -> None:
        """Set the timer of `member` to `moment`, unless it is set to an earlier one."""
        if moment < self._earliest.get(member, moment + 1):
            self._earliest[member] = moment
            heappush(self._heap, (moment, member))

    def due(self) -> int | None:
        """The next moment of any timer; None without one."""
        return self._heap[0][0] if self._heap else None

    def passed(self, now: int) -> Iterator[Member]:
        """The members whose moment has come, each once."""
        while self._heap and self._heap[0][0] <= now:
            moment, member = heappop(self._heap)
            if self._earliest.get(member) != moment:
                continue
            del self._earliest[member]
            actual = self._deadline(member)
            if actual is None:
                continue
            if actual > now:
                self.watch(member, actual)
            else:
                yield member


class RuleCondition:
    """The base of all conditions, of which only messages change the state. `paired`: agent -> the agents it holds
    with; `apart`: the pairs that it does not compare, where it compares pairs."""

    apart: ApartPairs | None = None

    def __init__(self) -> None:
        self.holding: set[Member] = set()
        self.paired: dict[str, dict[str, None]] = {}

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """The changes of a message; ValueError when its fields are not what the condition compares, NoNumberError when
        they are no numbers this time."""
        raise NotImplementedError

    def elapse(self, now: int) -> Sequence[MemberChange]:
        """The changes that the time alone causes, up to `now` on this machine's clock."""
        return ()

    def due(self) -> int | None:
        """The next moment at which `elapse` may give changes; None without one."""
        return None

    def overlook(self, member: Member, received: int, stamp: int | None) -> None:
        """Note that a message has come which is not evaluated: one that is older than the last one, or whose `stamp` is
        not to be believed (None)."""

    def in_doubt(self, stamp: int) -> bool:
        """Return whether the time may still show a change at `stamp` or before it."""
        return False

    def forget(self, agent: str) -> None:
        """Forget an agent that has fallen silent or whose time has begun anew."""

    def mark(self, member: Member, holds: bool) -> None:
        """Record that the condition holds for a member, or does not, by a change or an event that began earlier."""
        if holds:
            self.holding.add(member)
        else:
            self.holding.discard(member)
        if len(member) == 2:
            self._pair_up(member, holds)
            self._pair_up(member[::-1], holds)

    def partners(self, agent: str) -> Iterable[str]:
        """The agents with which it holds for this agent."""
        return self.paired.get(agent, ())

    def _pair_up(self, member: Member, holds: bool) -> None:
        agent, other = member
        if holds:
            self.paired.setdefault(agent, {})[other] = None
        elif agent in self.paired:
            self.paired[agent].pop(other, None)
            if not self.paired[agent]:
                del self.paired[agent]


def beyond(level: Level, value: float) -> int:
    """RISE beyond the start, FALL on the other side of the stop, KEEP between (and for what is no number)."""
    if level.above:
        return RISE if value > level.start else FALL if value < level.stop else KEEP
    return RISE if value < level.start else FALL if value > level.stop else KEEP


class ThresholdCondition(RuleCondition):
    """The condition that a number is beyond a bound."""

    def __init__(self, settings: Threshold) -> None:
        super().__init__()
        self._level = settings.level
        self._field = settings.field

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """See the base."""
        (value,) = reading.values
        if not isinstance(value, (int, float)):
            raise ValueError(f"{self._field} is no number")
        if value != value:
            raise NoNumberError(f"{self._field} is NaN")
        verdict = beyond(self._level, value)
        member = (reading.agent,)
        if verdict == KEEP or (verdict == RISE) == (member in self.holding):
            return ()
        cause = Cause(reading.topic, reading.stamp, {self._field: value})
        return (MemberChange(member, verdict, reading.stamp, reading.received, {self._field: float(value)}, (cause,)),)


class GeofenceCondition(RuleCondition):
    """The condition that a position is within an area, or outside it."""

    def __init__(self, settings: Geofence) -> None:
        super().__init__()
        self._settings = settings
        self._area = Area(settings.polygons)

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """See the base."""
        x, y = reading.values
        if not isinstance(x, (int, float)) or not isinstance(y, (int, float)):
            raise ValueError(f"{self._settings.x} and {self._settings.y} are no numbers")
        if not isfinite(x) or not isfinite(y):
            raise NoNumberError(f"{self._settings.x} and {self._settings.y} are no position")
        member = (reading.agent,)
        begun = member in self.holding
        verdict = RISE if self._area.contains(x, y) == self._settings.inside else FALL
        if (verdict == RISE) == begun:
            return ()
        if verdict == FALL and self._settings.margin and self._area.distance(x, y) <= self._settings.margin:
            return ()
        values = {self._settings.x: x, self._settings.y: y}
        cause = Cause(reading.topic, reading.stamp, values)
        return (MemberChange(member, verdict, reading.stamp, reading.received, values, (cause,)),)
