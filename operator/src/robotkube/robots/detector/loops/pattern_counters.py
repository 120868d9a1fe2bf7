"""Sums of the counters of all topics of a pattern, with those that are forgotten, so that counters never fall."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping

from robotkube.robots.detector.loops.input_counters import InputCounter
from robotkube.robots.ros.core.ring_buffers import RingBuffer

COUNTED = ("received", "malformed", "lost", "incompatible", "missed_deadlines", "lost_liveliness")
BUFFERED = ("late", "ahead", "duplicates", "jumps")
EVICTED = ("evicted_seconds", "evicted_bytes", "evicted_count", "evicted_process")

CounterSource = InputCounter | RingBuffer


class PatternCounters:
    """The sums of COUNTED, BUFFERED and `evicted` by pattern.

    The lock makes the removal of a topic one step for readers on other threads. It is held while numbers are added up,
    and the receiving thread needs it only to forget a topic or to change the patterns.
    """

    def __init__(self, sources: Callable[[], Iterable[tuple[str, CounterSource]]]) -> None:
        """`sources` gives the counters and buffers that are there now, each with its pattern."""
        self._sources = sources
        self._lock = threading.Lock()
        self._forgotten: dict[str, dict[str, int]] = {}

    def forget(self, pattern: str, source: CounterSource, remove: Callable[[], object]) -> None:
        """Keep the numbers of a counter or buffer that `remove` removes."""
        with self._lock:
            if pattern in self._forgotten:
                _add(self._forgotten[pattern], source)
            remove()

    def adapt(self, patterns: Iterable[str]) -> None:
        """Change the patterns; the numbers of those that are not among them are dropped."""
        with self._lock:
            self._forgotten = {pattern: self._forgotten.get(pattern) or _nothing() for pattern in patterns}

    def read(self) -> Mapping[str, Mapping[str, int]]:
        """The sums of every pattern of the settings; any thread."""
        with self._lock:
            sums_by_pattern = {pattern: dict(sums) for pattern, sums in self._forgotten.items()}
            for pattern, source in self._sources():
                if pattern in sums_by_pattern:
                    _add(sums_by_pattern[pattern], source)
        return sums_by_pattern


def _nothing() -> dict[str, int]:
    return dict.fromkeys((*COUNTED, *BUFFERED, "evicted"), 0)


def _add(sums: dict[str, int], source: CounterSource) -> None:
    if isinstance(source, RingBuffer):
        sums["evicted"] += sum(getattr(source, name) for name in EVICTED)
    for name in BUFFERED if isinstance(source, RingBuffer) else COUNTED:
        sums[name] += getattr(source, name)
