"""What the topics of a pattern have counted together, those included that are forgotten: counters never fall."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping

from robotkube.domain.buffers import RingBuffer
from robotkube.services.detector.counting import InputCounter

COUNTED = ("received", "malformed", "lost", "incompatible", "missed_deadlines", "lost_liveliness")
BUFFERED = ("late", "duplicates", "jumps")
EVICTED = ("evicted_seconds", "evicted_bytes", "evicted_count", "evicted_process")

Part = InputCounter | RingBuffer


class Totals:
    """Pattern -> sums of COUNTED, BUFFERED and `evicted`.

    The lock makes a topic's leaving one step for who reads beside. It is held while numbers are added up, and the
    receiving thread takes it only to forget a topic or to change the patterns.
    """

    def __init__(self, parts: Callable[[], Iterable[tuple[str, Part]]]) -> None:
        """`parts` gives what is there now: pattern and counter, or buffer."""
        self._parts, self._lock = parts, threading.Lock()
        self._gone: dict[str, dict[str, int]] = {}

    def forget(self, pattern: str, part: Part, remove: Callable[[], object]) -> None:
        """Keep the numbers of a part that `remove` takes away."""
        with self._lock:
            if pattern in self._gone:
                _add(self._gone[pattern], part)
            remove()

    def adapt(self, patterns: Iterable[str]) -> None:
        """Other patterns from now on; the numbers of those that are not among them are over."""
        with self._lock:
            self._gone = {pattern: self._gone.get(pattern) or _nothing() for pattern in patterns}

    def read(self) -> Mapping[str, Mapping[str, int]]:
        """The sums of every pattern of the settings; any thread."""
        with self._lock:
            found = {pattern: dict(sums) for pattern, sums in self._gone.items()}
            for pattern, part in self._parts():
                if pattern in found:
                    _add(found[pattern], part)
        return found


def _nothing() -> dict[str, int]:
    return dict.fromkeys((*COUNTED, *BUFFERED, "evicted"), 0)


def _add(sums: dict[str, int], part: Part) -> None:
    if isinstance(part, RingBuffer):
        sums["evicted"] += sum(getattr(part, name) for name in EVICTED)
    for name in BUFFERED if isinstance(part, RingBuffer) else COUNTED:
        sums[name] += getattr(part, name)
