"""How long the packets of one direction wait, and the queue in which they do. Pure.

The delay moves evenly from one random value to the next, so packets keep their order and one that follows another at
once waits as long: were it drawn for each packet, whoever keeps the order would make a dense stream always wait for the
longest. Times are seconds of any monotonic clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

STEP_SECONDS = 0.1
"""From one random value to the next."""


class Packet(NamedTuple):
    """A packet and when it is due."""

    due: float
    data: bytes


class VaryingDelay:
    """A delay of `seconds`, by up to `jitter_seconds` shorter or longer. `random`: numbers from 0 to 1."""

    def __init__(self, seconds: float, jitter_seconds: float, random: Callable[[], float]) -> None:
        self._least = max(0.0, seconds - jitter_seconds)
        self._width = seconds + jitter_seconds - self._least
        self._random = random
        self._begin = float("-inf")
        self._from = self._to = self._drawn()

    def at(self, now: float) -> float:
        """The delay of a packet that comes now."""
        passed = now - self._begin
        if passed >= STEP_SECONDS:
            missed = passed >= 2 * STEP_SECONDS
            self._from = self._drawn() if missed else self._to
            self._begin = now if missed else self._begin + STEP_SECONDS
            self._to = self._drawn()
            passed = now - self._begin
        return self._from + (self._to - self._from) * passed / STEP_SECONDS

    def _drawn(self) -> float:
        return self._least + self._width * self._random()


class DelayedQueue:
    """Packets that wait, in their order, at most `bytes_max` of them; `dropped` counts those that found no place."""

    def __init__(self, delay: VaryingDelay, bytes_max: int) -> None:
        self._delay = delay
        self._bytes_max = bytes_max
        self._waiting: deque[Packet] = deque()
        self._bytes = 0
        self._last = float("-inf")
        self.dropped = 0

    def put(self, data: bytes, now: float) -> None:
        """Add a packet that came now."""
        if self._bytes + len(data) > self._bytes_max:
            self.dropped += 1
            return
        self._last = max(self._last, now + self._delay.at(now))
        self._waiting.append(Packet(self._last, data))
        self._bytes += len(data)

    def due(self, now: float) -> bytes | None:
        """The next packet that is due, or None."""
        if not self._waiting or self._waiting[0].due > now:
            return None
        data = self._waiting.popleft().data
        self._bytes -= len(data)
        return data

    @property
    def next_due(self) -> float | None:
        """The time at which the next packet is due; None when none waits."""
        return self._waiting[0].due if self._waiting else None
