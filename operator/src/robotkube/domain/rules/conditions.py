"""What rules compare: a condition remembers what it needs and says when it begins and ceases to hold, for whom.

Findings are changes only: `holding` has the members for whom it holds; who uses the condition marks them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush

from robotkube.domain.rules.areas import Area
from robotkube.domain.rules.edges import Cause
from robotkube.domain.rules.messages import FALL, KEEP, RISE, Finding, Member, Reading
from robotkube.domain.rules.specifications import Geofence, Level, Threshold

GRACE_NS = 100_000_000
"""So long a moment that should have shown itself by a message is waited for, because messages take their time."""


def earliest(moments: Iterable[int | None]) -> int | None:
    """The first of the moments; None when there is none."""
    found = None
    for moment in moments:
        if moment is not None and (found is None or moment < found):
            found = moment
    return found


class Timers:
    """At which moment of this machine's clock (ns) something has to be looked at, per member.

    `deadline` says it anew when the moment has come, for it may have moved on; None when there is none any more.
    """

    def __init__(self, deadline: Callable[[Member], int | None]) -> None:
        self._deadline = deadline
        self._heap: list[tuple[int, Member]] = []
        self._earliest: dict[Member, int] = {}

    def watch(self, member: Member, moment: int) -> None:
        """Look at `member` at `moment`, or earlier if that was asked for before."""
        if moment < self._earliest.get(member, moment + 1):
            self._earliest[member] = moment
            heappush(self._heap, (moment, member))

    def due(self) -> int | None:
        """The next moment; nothing happens before it."""
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


class Condition:
    """The beginning of a condition that only messages change. `paired`: agent -> with whom it holds for the agent."""

    def __init__(self) -> None:
        self.holding: set[Member] = set()
        self.paired: dict[str, dict[str, None]] = {}

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """What a message changes. ValueError: its fields are not what the condition compares."""
        raise NotImplementedError

    def elapse(self, now: int) -> Sequence[Finding]:
        """What the time alone has changed up to `now` on this machine's clock."""
        return ()

    def due(self) -> int | None:
        """When `elapse` may have something to say."""
        return None

    def forget(self, agent: str) -> None:
        """Let go of an agent that has fallen silent or whose time has begun anew."""

    def mark(self, member: Member, holds: bool) -> None:
        """Take note of what has been made of a finding, or of an event that began earlier."""
        if holds:
            self.holding.add(member)
        else:
            self.holding.discard(member)
        if len(member) == 2:
            self._pair_up(member, holds)
            self._pair_up(member[::-1], holds)

    def partners(self, agent: str) -> Iterable[str]:
        """With whom it holds for the agent."""
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


class ThresholdCondition(Condition):
    """A number beyond a bound."""

    def __init__(self, settings: Threshold) -> None:
        super().__init__()
        self._level, self._field = settings.level, settings.field

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """See the base."""
        (value,) = reading.values
        if not isinstance(value, (int, float)):
            raise ValueError(f"{self._field} is no number")
        verdict, member = beyond(self._level, value), (reading.agent,)
        if verdict == KEEP or (verdict == RISE) == (member in self.holding):
            return ()
        cause = Cause(reading.topic, reading.stamp, {self._field: value})
        return (Finding(member, verdict, reading.stamp, reading.received, {self._field: float(value)}, (cause,)),)


class GeofenceCondition(Condition):
    """A position within an area, or outside it."""

    def __init__(self, settings: Geofence) -> None:
        super().__init__()
        self._settings, self._area = settings, Area(settings.polygons)

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """See the base."""
        x, y = reading.values
        if not isinstance(x, (int, float)) or not isinstance(y, (int, float)) or x != x or y != y:
            raise ValueError(f"{self._settings.x} and {self._settings.y} are no numbers")
        member = (reading.agent,)
        begun = member in self.holding
        verdict = RISE if self._area.holds(x, y) == self._settings.inside else FALL
        if (verdict == RISE) == begun:
            return ()
        if verdict == FALL and self._settings.margin and self._area.distance(x, y) <= self._settings.margin:
            return ()
        values = {self._settings.x: x, self._settings.y: y}
        cause = Cause(reading.topic, reading.stamp, values)
        return (Finding(member, verdict, reading.stamp, reading.received, values, (cause,)),)
