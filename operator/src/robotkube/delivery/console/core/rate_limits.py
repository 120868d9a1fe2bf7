"""How often one source may ask: a bucket of requests for each, filled again as time passes."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

SOURCES_MAX = 10_000


@dataclass(frozen=True)
class RequestRate:
    """A rate at which somebody may ask: `burst` requests at once, and `per_second` for as long as it likes."""

    burst: float
    per_second: float


class RateLimits:
    """The buckets of all sources; of too many the one that asked longest ago is forgotten."""

    def __init__(self, rate: RequestRate, sources_max: int = SOURCES_MAX) -> None:
        self._rate = rate
        self._sources_max = sources_max
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()  # requests left, and when

    def wait_seconds(self, source: str, now: float) -> float:
        """Count a request of `source` at `now` (seconds): 0 when it may, else in how many seconds it may."""
        left, at = self._left.get(source, (self._rate.burst, now))
        left = min(self._rate.burst, left + max(now - at, 0.0) * self._rate.per_second)
        allowed = left >= 1.0
        self._left[source] = (left - 1.0 if allowed else left, now)
        self._left.move_to_end(source)
        if len(self._left) > self._sources_max:
            self._left.popitem(last=False)
        return 0.0 if allowed else (1.0 - left) / self._rate.per_second
