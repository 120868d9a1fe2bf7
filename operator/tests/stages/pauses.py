"""Pauses of a loop between its steps, seen without waiting."""

from __future__ import annotations

import threading


class Pauses(threading.Event):
    """An event for which nobody waits: `seconds` has what every wait asked for, and after so many of them `stopping` is
    set (it may be the event itself)."""

    def __init__(self, count: int, stopping: threading.Event | None = None) -> None:
        super().__init__()
        self.seconds: list[float] = []
        self._count = count
        self._stopping = stopping or self

    def wait(self, timeout: float | None = None) -> bool:
        """Return at once; a wait of no time only asks whether the event is set."""
        if timeout:
            self.seconds.append(timeout)
        if len(self.seconds) >= self._count:
            self._stopping.set()
        return self.is_set()
