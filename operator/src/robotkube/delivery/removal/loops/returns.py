"""Returns: what comes again after it was taken away, and how long the remover waits for each next time.

Whoever makes a stranger may make it again at once. Taken away at once as well, two processes would keep a machine busy
with nothing else. So each maker has pauses of its own, which grow.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from robotkube.backoffs import Random, backoff
from robotkube.delivery.removal.core.makers import Maker

PAUSE_SECONDS_MIN = 5.0
PAUSE_SECONDS_MAX = 300.0
FORGET_SECONDS = 1800.0  # longer than any pause: who is quiet for so long begins anew
MINUTE_SECONDS = 60.0


@dataclass(frozen=True)
class _Removals:
    """How often something of one maker was taken away, when last, and when it may be again (seconds of one clock)."""

    count: int
    last: float
    next: float


@dataclass
class Returns:
    """The removals so far, by what was done (`act`, a word) and whose it was. Times are seconds of a clock that never
    goes back; of all together at most `per_minute`."""

    random: Random
    per_minute: int
    _known: dict[tuple[str, Maker], _Removals] = field(default_factory=dict)
    _recent: list[float] = field(default_factory=list)

    def count(self, act: str, maker: Maker) -> int:
        """How often."""
        known = self._known.get((act, maker))
        return known.count if known else 0

    def since(self, act: str, maker: Maker, now: float) -> float:
        """Seconds since the last time; infinite when there was none."""
        known = self._known.get((act, maker))
        return now - known.last if known else float("inf")

    def is_due(self, act: str, maker: Maker, now: float) -> bool:
        """Return whether its pause is over; it has none within one turn, at one time `now`."""
        known = self._known.get((act, maker))
        return known is None or now >= known.next or now == known.last

    def is_full(self, now: float) -> bool:
        """Return whether so much was taken away in the last minute that something else must be wrong."""
        self._recent = [at for at in self._recent if now - at < MINUTE_SECONDS]
        return len(self._recent) >= self.per_minute

    def note(self, act: str, maker: Maker, now: float) -> None:
        """Record that something is taken away now. What belongs to one maker and goes in one turn counts once for its
        pauses."""
        self._recent.append(now)
        known = self._known.get((act, maker))
        if known is not None and known.last == now:
            return
        count = known.count + 1 if known else 1
        pause = PAUSE_SECONDS_MIN + backoff(
            count - 1, PAUSE_SECONDS_MIN, PAUSE_SECONDS_MAX - PAUSE_SECONDS_MIN, self.random
        )
        self._known[act, maker] = _Removals(count, now, now + pause)

    def forget(self, now: float) -> None:
        """Forget who was quiet for FORGET_SECONDS."""
        self._known = {key: one for key, one in self._known.items() if now - one.last < FORGET_SECONDS}

    def coming_again(self) -> int:
        """How many makers made something again that had been taken away."""
        return len({maker for (_, maker), one in self._known.items() if one.count > 1})
