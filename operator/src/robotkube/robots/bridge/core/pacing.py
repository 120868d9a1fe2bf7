"""The pacing of a backlog: what waited for a broker that was away leaves in the order in which it came, but not at
once.

Receivers, the broker and the uplink are made for the rate at which messages come. Times are seconds of any monotonic
clock.
"""

from __future__ import annotations

FRESH_SECONDS = 1.0
"""What is younger is no backlog."""
SPEED = 5.0
"""How much faster than it came a backlog leaves: 60 s of it within 15 s, with all that comes meanwhile."""
STEP_SECONDS_MAX = 0.2
"""What counts of the time between two looks: nothing is saved up while nothing may leave."""
QUIET_SECONDS_MAX = 1.0
"""What counts of the time in which nothing came: silence takes no more than this to pass."""


class Pacing:
    """The place that a backlog has reached, by the time at which its batches were put."""

    def __init__(self) -> None:
        self.active = False
        self._reached = self._at = 0.0

    def allows(self, born: float, now: float) -> bool:
        """Return whether the first batch that waits may leave; it was put at `born`."""
        if now - born <= FRESH_SECONDS:
            self.active = False
            return True
        if self.active:
            step = SPEED * min(now - self._at, STEP_SECONDS_MAX)
            self._reached = max(self._reached, born - QUIET_SECONDS_MAX) + step
        else:
            self._reached = born
        self.active = True
        self._at = now
        return born <= self._reached

    def end(self) -> None:
        """Forget the backlog: it is gone, or begins anew."""
        self.active = False
