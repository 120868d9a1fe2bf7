"""Garbage collection between decisions instead of in the middle of one.

Python's full collection visits every container of the process: catalogue, nodes and tasks of a large fleet cost tens
of milliseconds, and they are no garbage. So they are collected in full between two steps and then set aside
(`gc.freeze`): collections that Python starts by itself only visit what came since. Nothing is set aside for good.
"""

from __future__ import annotations

import gc
from collections.abc import Callable

SWEEP_SECONDS = 60.0


class Sweeper:
    """Collector of garbage, called between steps; the first call sweeps, and the first SWEEP_SECONDS after the last
    that did.

    `monotonic` is a clock in seconds that never goes back."""

    def __init__(self, monotonic: Callable[[], float], seconds: float = SWEEP_SECONDS) -> None:
        self._monotonic = monotonic
        self._seconds = seconds
        self._due = float("-inf")

    def __call__(self) -> None:
        """Collect everything and set aside what stays, when it is time."""
        now = self._monotonic()
        if now < self._due:
            return
        self._due = now + self._seconds
        gc.unfreeze()
        gc.collect()
        gc.freeze()
