"""The ring buffer of a topic: its latest serialised messages in the order of their stamps, within three bounds."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from operator import attrgetter

_stamp = attrgetter("stamp")


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message: source stamp and time of reception (ns since 1970), serialised bytes."""

    stamp: int
    received: int
    data: bytes


class RingBuffer:
    """Keeps messages no older than `seconds` before the newest, at most `bytes_max` and `count_max` of them.

    Messages may come in any order and are kept in the order of their stamps; one that is older than the window is
    counted in `late` and dropped. A `latched` buffer has no window: its topic says something once. `evicted` counts
    what left because of bytes or count, before its time.
    """

    def __init__(self, seconds: float, bytes_max: int, count_max: int, latched: bool = False) -> None:
        self._window_ns = None if latched else int(seconds * 1e9)
        self._bytes_max, self._count_max = bytes_max, count_max
        self._samples: deque[Sample] = deque()
        self.bytes = 0
        self.late = 0
        self.disordered = 0
        self.evicted = 0

    def __len__(self) -> int:
        return len(self._samples)

    def insert(self, sample: Sample) -> None:
        """Take a message in; older ones leave as the bounds ask."""
        samples = self._samples
        if not samples or sample.stamp >= samples[-1].stamp:
            samples.append(sample)
        elif self._window_ns is not None and sample.stamp < samples[-1].stamp - self._window_ns:
            self.late += 1
            return
        else:
            self.disordered += 1
            samples.insert(bisect_right(samples, sample.stamp, key=_stamp), sample)
        self.bytes += len(sample.data)
        self._evict()

    def since(self, stamp: int) -> list[Sample]:
        """The messages with this stamp or a later one, oldest first."""
        return [sample for sample in self._samples if sample.stamp >= stamp]

    def _evict(self) -> None:
        samples = self._samples
        if self._window_ns is not None:
            oldest = samples[-1].stamp - self._window_ns
            while samples[0].stamp < oldest:
                self.bytes -= len(samples.popleft().data)
        while samples and (self.bytes > self._bytes_max or len(samples) > self._count_max):
            self.bytes -= len(samples.popleft().data)
            self.evicted += 1
