"""Conditions on the arrival of messages: their rate, and their absence. Time alone may change them."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf

from robotkube.robots.rules.core.conditions.levels import GRACE_NS, RuleCondition, Timers, beyond
from robotkube.robots.rules.core.events import Cause
from robotkube.robots.rules.core.messages import FALL, KEEP, NEVER, RISE, Member, MemberChange, MessageValues
from robotkube.robots.rules.core.specification.specifications import Absence, Rate

COUNTED_MAX = 20_000
"""The stamps that are kept: more than the bound of any rule needs."""


@dataclass
class _Arrivals:
    """The stamps of a member's messages within the window, when the counting began, and up to when they have left."""

    first: int
    topic: str
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=COUNTED_MAX))
    last: int = 0
    received: int = 0
    left: int = NEVER

    def moment(self, stamp: int) -> int:
        """The moment of `stamp` on this machine's clock."""
        return self.received + stamp - self.last + GRACE_NS


class RateCondition(RuleCondition):
    """The condition on messages in the window (t - window, t] per second, from the first window's end on."""

    def __init__(self, settings: Rate) -> None:
        super().__init__()
        self._level = settings.level
        self._window = settings.window_seconds
        self._window_ns = int(settings.window_seconds * 1e9)
        self._arrivals: dict[Member, _Arrivals] = {}
        self._timers = Timers(self._deadline)

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """See the base."""
        member = (reading.agent,)
        known = self._arrivals.get(member)
        if known is None:
            known = self._arrivals[member] = _Arrivals(reading.stamp, reading.topic)
        changes = list(self._leaving(member, known, reading.stamp - 1, reading.received))
        while known.stamps and known.stamps[0] + self._window_ns <= reading.stamp:
            known.stamps.popleft()  # leaves at the very moment at which this one comes: one change
        known.stamps.append(reading.stamp)
        known.last = reading.stamp
        known.received = reading.received
        changes += self._judged(member, known, reading.stamp, reading.received)
        moment = self._deadline(member)
        if moment is not None:
            self._timers.watch(member, moment)
        return changes

    def overlook(self, member: Member, received: int, stamp: int | None) -> None:
        """Count a message that has come late, where it belongs; one without a credible stamp beside the last one."""
        known = self._arrivals.get(member)
        if known is None:
            return
        known.received = max(known.received, received)
        moment = known.last if stamp is None else stamp
        if max(known.last, known.left) - self._window_ns < moment and len(known.stamps) < COUNTED_MAX:
            known.stamps.insert(bisect_right(known.stamps, moment), moment)

    def elapse(self, now: int) -> Sequence[MemberChange]:
        """See the base."""
        changes: list[MemberChange] = []
        for member in list(self._timers.passed(now)):
            known = self._arrivals[member]
            changes += self._leaving(member, known, known.last + now - known.received - GRACE_NS, now)
            moment = self._deadline(member)
            if moment is not None:
                self._timers.watch(member, max(moment, now + 1))
        return changes

    def due(self) -> int | None:
        """See the base."""
        return self._timers.due()

    def in_doubt(self, stamp: int) -> bool:
        """See the base: enough messages have left the window, and none has come since."""
        return any(self._turns(member, known) <= stamp for member, known in self._arrivals.items() if known.stamps)

    def forget(self, agent: str) -> None:
        """See the base."""
        self._arrivals.pop((agent,), None)

    def _turns(self, member: Member, known: _Arrivals) -> float:
        """The stamp at which the rate changes what it says when no more messages come."""
        if self._level.above == (member not in self.holding):
            return inf
        bound = self._level.stop if self._level.above else self._level.start
        most = len(known.stamps) - 1
        while most > 0 and most / self._window >= bound:
            most -= 1
        last_to_leave = known.stamps[len(known.stamps) - 1 - most]
        return last_to_leave + self._window_ns

    def _leaving(self, member: Member, known: _Arrivals, stamp: int, received: int) -> Iterator[MemberChange]:
        """The changes while messages leave the window, up to `stamp`."""
        known.left = max(known.left, stamp)
        while known.stamps and known.stamps[0] + self._window_ns <= stamp:
            moment = known.stamps.popleft() + self._window_ns
            while known.stamps and known.stamps[0] + self._window_ns == moment:
                known.stamps.popleft()
            yield from self._judged(member, known, moment, received)

    def _judged(self, member: Member, known: _Arrivals, stamp: int, received: int) -> Iterator[MemberChange]:
        rate = len(known.stamps) / self._window
        verdict = beyond(self._level, rate)
        if stamp < known.first + self._window_ns or verdict == KEEP or (verdict == RISE) == (member in self.holding):
            return
        cause = Cause(known.topic, known.last, {"hz": rate})
        # marked at once: one message may change it twice
        self.mark(member, verdict == RISE)
        yield MemberChange(member, verdict, stamp, received, {"hz": rate}, (cause,))

    def _deadline(self, member: Member) -> int | None:
        """The moment at which the next message leaves the window, on this machine's clock; None when that changes
        nothing."""
        known = self._arrivals.get(member)
        if known is None or not known.stamps or self._level.above == (member not in self.holding):
            return None
        return known.moment(known.stamps[0] + self._window_ns)


class AbsenceCondition(RuleCondition):
    """The condition that no message came for longer than a bound, counted from the last one; for expected agents from
    the begin."""

    def __init__(self, settings: Absence, expected: Iterable[str] = ()) -> None:
        super().__init__()
        self._bound_ns = int(settings.seconds * 1e9)
        self._topic = settings.topic
        self._expected = tuple(expected)
        self._last: dict[Member, tuple[int, int]] = {}
        self._timers = Timers(self._deadline)

    def begin(self, stamp: int, received: int) -> None:
        """Wait for the expected agents from now on."""
        for agent in self._expected:
            self._wait((agent,), stamp, received)

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """See the base."""
        member = (reading.agent,)
        changes = []
        last = self._last.get(member)
        if last is not None and member not in self.holding and reading.stamp - last[0] > self._bound_ns:
            changes.append(self._member_change(member, RISE, last[0] + self._bound_ns, reading.received))
        if changes or member in self.holding:
            changes.append(self._member_change(member, FALL, reading.stamp, reading.received))
        self._wait(member, reading.stamp, reading.received)
        return changes

    def overlook(self, member: Member, received: int, stamp: int | None) -> None:
        """Wait from now on: the message is measured as much later than the last one as it was received later."""
        last = self._last.get(member)
        if last is not None and received > last[1]:
            self._last[member] = last[0] + received - last[1], received

    def elapse(self, now: int) -> Sequence[MemberChange]:
        """See the base."""
        return [
            self._member_change(member, RISE, self._last[member][0] + self._bound_ns, now)
            for member in self._timers.passed(now)
        ]

    def due(self) -> int | None:
        """See the base."""
        return self._timers.due()

    def in_doubt(self, stamp: int) -> bool:
        """See the base."""
        return any(
            last + self._bound_ns <= stamp and member not in self.holding for member, (last, _) in self._last.items()
        )

    def forget(self, agent: str) -> None:
        """See the base."""
        self._last.pop((agent,), None)

    def _wait(self, member: Member, stamp: int, received: int) -> None:
        self._last[member] = stamp, received
        self._timers.watch(member, received + self._bound_ns + GRACE_NS)

    def _deadline(self, member: Member) -> int | None:
        last = self._last.get(member)
        return None if last is None or member in self.holding else last[1] + self._bound_ns + GRACE_NS

    def _member_change(self, member: Member, verdict: int, stamp: int, received: int) -> MemberChange:
        last = self._last.get(member, (stamp, received))[0]
        cause = Cause(self._topic.topic(member[0]), last, {})
        return MemberChange(member, verdict, stamp, received, {"silent_seconds": (stamp - last) / 1e9}, (cause,))
