"""Subscriptions that the broker refused, and when each is asked for again: a right may come later than who needs it."""

from __future__ import annotations

from collections.abc import Iterable

PAUSES_SECONDS = (1.0, 2.0, 4.0, 5.0)
"""The pauses before the next times; the last one for all that follow."""

NOT_ALLOWED = frozenset([0x80, 0x83, 0x87])  # unspecified, implementation specific, not authorized: what an ACL gives


def advice(reason: int) -> str:
    """The place where the reason of a refusal stands, as the end of its sentence."""
    place = "its rights, `robotkube agent rights`" if reason in NOT_ALLOWED else "the broker's limits and log"
    return f"; look at {place}"


class RefusedSubscriptions:
    """The filters that are refused, each with its next time. Times are seconds of one clock."""

    def __init__(self) -> None:
        self._times: dict[str, tuple[int, float]] = {}  # filter -> how often it was refused, and when it is asked next

    def refused(self, name: str, now: float) -> None:
        """The broker refuses it, for the first time or again."""
        before, _ = self._times.get(name, (0, 0.0))
        pause = PAUSES_SECONDS[min(before, len(PAUSES_SECONDS) - 1)]
        self._times[name] = (before + 1, now + pause)

    def granted(self, name: str) -> bool:
        """The broker takes it; whether it had refused it before."""
        return self._times.pop(name, None) is not None

    def forget(self, names: Iterable[str]) -> None:
        """Nobody wants these any more."""
        for name in names:
            self._times.pop(name, None)

    def clear(self) -> None:
        """Nothing is refused: the connection is a new one."""
        self._times.clear()

    def due(self, now: float) -> list[str]:
        """What is to be asked for now; not again before the broker has answered, or its next time."""
        names = [name for name, (_, at) in self._times.items() if at <= now]
        for name in names:
            self._times[name] = (self._times[name][0], now + PAUSES_SECONDS[-1])
        return names
