"""Conditions on when messages come: how many a second, and none for too long. Time alone may change them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from robotkube.domain.rules.conditions import GRACE_NS, Condition, Timers, beyond
from robotkube.domain.rules.edges import Cause
from robotkube.domain.rules.messages import FALL, KEEP, RISE, Finding, Member, Reading
from robotkube.domain.rules.specifications import Absence, Rate

COUNTED_MAX = 20_000
"""More than any bound of a rule asks for; older stamps are of no use then."""


@dataclass
class _Arrivals:
    """The stamps of a member's messages within the window, and when the counting began."""

    first: int
    topic: str
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=COUNTED_MAX))
    last: int = 0
    received: int = 0

    def moment(self, stamp: int) -> int:
        """When `stamp` comes on this machine's clock."""
        return self.received + stamp - self.last + GRACE_NS


class RateCondition(Condition):
    """Messages in the window (t - window, t] per second; told from the first window's end on."""

    def __init__(self, settings: Rate) -> None:
        super().__init__()
        self._level, self._window = settings.level, settings.window_seconds
        self._window_ns = int(settings.window_seconds * 1e9)
        self._arrivals: dict[Member, _Arrivals] = {}
        self._timers = Timers(self._deadline)

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """See the base."""
        member = (reading.agent,)
        known = self._arrivals.get(member)
        if known is None:
            known = self._arrivals[member] = _Arrivals(reading.stamp, reading.topic)
        found = list(self._leaving(member, known, reading.stamp - 1, reading.received))
        while known.stamps and known.stamps[0] + self._window_ns <= reading.stamp:
            known.stamps.popleft()  # leaves at the very moment at which this one comes: one change
        known.stamps.append(reading.stamp)
        known.last, known.received = reading.stamp, reading.received
        found += self._judged(member, known, reading.stamp, reading.received)
        moment = self._deadline(member)
        if moment is not None:
            self._timers.watch(member, moment)
        return found

    def elapse(self, now: int) -> Sequence[Finding]:
        """See the base."""
        found: list[Finding] = []
        for member in list(self._timers.passed(now)):
            known = self._arrivals[member]
            found += self._leaving(member, known, known.last + now - known.received - GRACE_NS, now)
            moment = self._deadline(member)
            if moment is not None:
                self._timers.watch(member, max(moment, now + 1))
        return found

    def due(self) -> int | None:
        """See the base."""
        return self._timers.due()

    def forget(self, agent: str) -> None:
        """See the base."""
        self._arrivals.pop((agent,), None)

    def _leaving(self, member: Member, known: _Arrivals, stamp: int, received: int) -> Iterator[Finding]:
        """What changes while messages leave the window, up to `stamp`."""
        while known.stamps and known.stamps[0] + self._window_ns <= stamp:
            moment = known.stamps.popleft() + self._window_ns
            while known.stamps and known.stamps[0] + self._window_ns == moment:
                known.stamps.popleft()
            yield from self._judged(member, known, moment, received)

    def _judged(self, member: Member, known: _Arrivals, stamp: int, received: int) -> Iterator[Finding]:
        rate = len(known.stamps) / self._window
        verdict = beyond(self._level, rate)
        if stamp < known.first + self._window_ns or verdict == KEEP or (verdict == RISE) == (member in self.holding):
            return
        cause = Cause(known.topic, known.last, {"hz": rate})
        # marked at once: one message may change it twice
        self.mark(member, verdict == RISE)
        yield Finding(member, verdict, stamp, received, {"hz": rate}, (cause,))

    def _deadline(self, member: Member) -> int | None:
        """When the next message leaves the window, on this machine's clock; None when nothing can change by that."""
        known = self._arrivals.get(member)
        if known is None or not known.stamps or self._level.above == (member not in self.holding):
            return None
        return known.moment(known.stamps[0] + self._window_ns)


class AbsenceCondition(Condition):
    """No message for longer than a bound, counted from the last one; of agents that are expected, from the begin."""

    def __init__(self, settings: Absence, expected: Iterable[str] = ()) -> None:
        super().__init__()
        self._bound_ns = int(settings.seconds * 1e9)
        self._topic = settings.topic
        self._expected = tuple(expected)
        self._last: dict[Member, tuple[int, int]] = {}
        self._timers = Timers(self._deadline)

    def begin(self, stamp: int, received: int) -> None:
        """The expected agents are waited for from now on."""
        for agent in self._expected:
            self._wait((agent,), stamp, received)

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """See the base."""
        member, found = (reading.agent,), []
        last = self._last.get(member)
        if last is not None and member not in self.holding and reading.stamp - last[0] > self._bound_ns:
            found.append(self._finding(member, RISE, last[0] + self._bound_ns, reading.received))
        if found or member in self.holding:
            found.append(self._finding(member, FALL, reading.stamp, reading.received))
        self._wait(member, reading.stamp, reading.received)
        return found

    def elapse(self, now: int) -> Sequence[Finding]:
        """See the base."""
        return [
            self._finding(member, RISE, self._last[member][0] + self._bound_ns, now)
            for member in self._timers.passed(now)
        ]

    def due(self) -> int | None:
        """See the base."""
        return self._timers.due()

    def forget(self, agent: str) -> None:
        """See the base."""
        self._last.pop((agent,), None)

    def _wait(self, member: Member, stamp: int, received: int) -> None:
        self._last[member] = stamp, received
        self._timers.watch(member, received + self._bound_ns + GRACE_NS)

    def _deadline(self, member: Member) -> int | None:
        last = self._last.get(member)
        return None if last is None or member in self.holding else last[1] + self._bound_ns + GRACE_NS

    def _finding(self, member: Member, verdict: int, stamp: int, received: int) -> Finding:
        last = self._last.get(member, (stamp, received))[0]
        cause = Cause(self._topic.topic(member[0]), last, {})
        return Finding(member, verdict, stamp, received, {"silent_seconds": (stamp - last) / 1e9}, (cause,))
