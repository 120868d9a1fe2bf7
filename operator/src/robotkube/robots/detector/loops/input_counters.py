"""Counters of what arrived on one topic, as `/input` shows them.

The receiving thread writes them, others read them without a lock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

SECONDS_KEPT = 1800
AGE_MS_MAX = 1000


class InputCounter:
    """The counters of a topic: messages per second of reception, and their ages, in total and by second; `pattern`: the
    topic in the settings."""

    __slots__ = (
        "_ages", "_ages_now", "_quantiles", "_second", "_seconds", "incompatible", "lost", "lost_liveliness",
        "malformed", "missed_deadlines",
        "newest", "pattern", "received", "type",
    )  # fmt: skip

    def __init__(self, type_name: str, pattern: str) -> None:
        self.type = type_name
        self.pattern = pattern
        self.received = 0
        self.malformed = 0
        self.newest = 0
        self.lost = self.incompatible = self.missed_deadlines = self.lost_liveliness = 0
        self._seconds: deque[list[int]] = deque(maxlen=SECONDS_KEPT)
        self._second: list[int] = [0, 0]
        self._ages = [0] * (AGE_MS_MAX + 1)
        self._ages_now: list[int] = []
        self._quantiles: deque[list[int]] = deque(maxlen=SECONDS_KEPT)

    def count(self, stamp: int, received: int) -> None:
        """Count a message measured at `stamp` and received at `received` (ns)."""
        self.received += 1
        self.newest = received
        second = self._second
        if received // 1_000_000_000 != second[0]:
            self._close(second[0])
            second = self._second = [received // 1_000_000_000, 0]
            self._seconds.append(second)
        second[1] += 1
        age = (received - stamp) // 1_000_000
        age = age if 0 <= age < AGE_MS_MAX else 0 if age < 0 else AGE_MS_MAX
        self._ages[age] += 1
        self._ages_now.append(age)

    def _close(self, second: int) -> None:
        """Keep the quantiles of a second's ages when the next one begins."""
        if self._ages_now:
            ages = sorted(self._ages_now)
            self._quantiles.append([second, _quantile(ages, 0.5), _quantile(ages, 0.99)])
            self._ages_now.clear()

    def document(self, unreadable: int = 0) -> dict[str, Any]:
        """The counter as JSON values; `unreadable`: messages whose fields a rule could not read."""
        return {
            "type": self.type,
            "received": self.received,
            "dropped": self.lost,
            "malformed": self.malformed + unreadable,
            "seconds": [list(pair) for pair in list(self._seconds)],
            "ages_ms": [[age, count] for age, count in enumerate(self._ages) if count],
            "age_quantiles_ms": [list(quantile) for quantile in list(self._quantiles)],
        }


def _quantile(ordered: Sequence[int], share: float) -> int:
    """The value that `share` of the values do not exceed."""
    return ordered[math.ceil(share * len(ordered)) - 1]
