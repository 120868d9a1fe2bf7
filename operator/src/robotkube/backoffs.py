"""How long to wait before the next attempt: exponential back-off with full jitter.

Many processes lose the same server at the same moment. Each waits any time up to a bound that doubles, so that they do
not come back together, and the bound keeps them from asking too often. (M. Brooker, "Exponential Backoff And Jitter",
AWS Architecture Blog, 2015.) What a process starts anew beside itself, such as a rule's process, needs none of it.
"""

from __future__ import annotations

from collections.abc import Callable

DOUBLINGS_MAX = 32

Random = Callable[[], float]
"""A number from 0 up to, but not including, 1: `random.random`, or a test's own."""


def backoff(attempt: int, minimum: float, maximum: float, random: Random) -> float:
    """Seconds to wait after `attempt` earlier ones (0 for the first): any time up to `minimum`, doubled with every
    attempt, at most `maximum`."""
    return min(maximum, minimum * 2.0 ** min(attempt, DOUBLINGS_MAX)) * random()
