"""Ring buffers: the latest serialised messages of each topic in the order of their stamps, within bounds.

One thread inserts. Every reading method may be called from any thread and sees the buffer as it was at one moment.
How time, order, duplicates and jumps are treated stands in docs/explanation/buffer-and-time.md.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heapreplace
from operator import attrgetter
from types import MappingProxyType

from robotkube.robots.ros.core.source_clocks import (
    AHEAD,
    DISORDERED,
    FOREVER_NS,
    JUMP_KEEP,
    JUMP_RESTART,
    JUMPED,
    LATE,
    NEXT,
    Sample,
    SourceClock,
)

__all__ = [
    "AHEAD",
    "DISORDERED",
    "DUPLICATE",
    "JUMPED",
    "JUMP_KEEP",
    "JUMP_RESTART",
    "KEPT",
    "LATE",
    "BufferBounds",
    "BufferPool",
    "RingBuffer",
    "Sample",
]  # fmt: skip

KEPT, DUPLICATE = "kept", "duplicate"
"""The outcomes of an insertion: KEPT as the newest, DISORDERED between older ones, or JUMPED. Not inserted are LATE,
AHEAD and DUPLICATE, which was there already."""

DUPLICATES_DROP, DUPLICATES_KEEP = "drop", "keep"

COUNT_DEFAULT = 100_000
DUPLICATES_COMPARED_MAX = 100

COUNTERS = (
    "received", "late", "ahead", "disordered", "duplicates", "jumps", "cleared",
    "evicted_seconds", "evicted_bytes", "evicted_count", "evicted_process",
)  # fmt: skip

_RELIEF_SHARE = 64
_READS_MAX = 100

_stamp = attrgetter("stamp")


@dataclass(frozen=True, slots=True)
class BufferBounds:
    """The bounds of a buffer: `seconds` before its newest stamp, `bytes` of serialised messages, `count` messages."""

    seconds: float
    bytes: int
    count: int = COUNT_DEFAULT


@dataclass(slots=True)
class _Budget:
    """The bytes that several buffers hold together, and the most they may hold."""

    bytes_max: int
    buffers: list[RingBuffer]
    bytes: int = 0

    def relieve(self) -> None:
        """Drop the oldest messages of the buffers that hold most; a little more than needed, so that it is rarely
        done."""
        target = self.bytes_max - self.bytes_max // _RELIEF_SHARE
        heap = [(-buffer.bytes, order, buffer) for order, buffer in enumerate(self.buffers) if buffer.bytes]
        heapify(heap)
        while self.bytes > target and heap:
            _, order, buffer = heap[0]
            buffer.drop_oldest()
            if buffer.bytes:
                heapreplace(heap, (-buffer.bytes, order, buffer))
            else:
                heappop(heap)


class RingBuffer:
    """The messages of one topic.

    Counters, all of which only grow: `received` = kept + late + ahead + duplicates; of those kept, `disordered` came
    after a newer one; `evicted_*` and `cleared` left because of age, bytes, count, the process's bytes or a jump;
    `jumps`. A `latched` buffer has no window and no part in the process's bytes: its publishers send a message once.
    `judges`: False believes every stamp, since another clock has judged it.
    """

    __slots__ = (
        *COUNTERS, "_budget", "_bytes_max", "_count_max", "_samples", "_window_ns", "bytes", "clock",
        "duplicate_policy", "latched",
    )  # fmt: skip

    def __init__(
        self,
        bounds: BufferBounds,
        latched: bool = False,
        duplicates: str = DUPLICATES_DROP,
        jump: str = JUMP_RESTART,
        budget: _Budget | None = None,
        judges: bool = True,
    ) -> None:
        self.latched = latched
        self.duplicate_policy = duplicates
        self._window_ns = FOREVER_NS if latched else int(bounds.seconds * 1e9)
        self.clock = SourceClock(self._window_ns, jump, judges and not latched)
        self._bytes_max = bounds.bytes
        self._count_max = bounds.count
        self._budget = budget or _Budget(FOREVER_NS, [])
        self._samples: deque[Sample] = deque()
        self.bytes = self.received = self.late = self.ahead = self.disordered = self.duplicates = self.jumps = 0
        self.cleared = self.evicted_seconds = self.evicted_bytes = self.evicted_count = self.evicted_process = 0

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def kept(self) -> int:
        """The number of messages that were inserted."""
        return self.received - self.late - self.ahead - self.duplicates

    def insert(self, sample: Sample) -> str:
        """Insert a message; older ones leave as the bounds ask. Returns KEPT, DISORDERED or JUMPED, or else why it was
        not inserted: LATE, AHEAD or DUPLICATE."""
        stamp, received, data = sample
        self.received += 1
        outcome = KEPT
        samples = self._samples
        clock = self.clock
        if clock.newest < stamp <= clock.limit:
            samples.append(sample)
            clock.newest = stamp
            clock.newest_received = received
            clock.limit = stamp + clock.window_ns
        else:
            outcome = self._place(sample)
            if outcome is LATE or outcome is AHEAD or outcome is DUPLICATE:
                return outcome
        size = len(data)
        budget = self._budget
        self.bytes += size
        budget.bytes += size
        if (
            samples[0][0] < clock.newest - self._window_ns  # the stamp; by its place it takes half as long
            or self.bytes > self._bytes_max
            or len(samples) > self._count_max
        ):
            self._evict()
        if budget.bytes > budget.bytes_max:
            budget.relieve()
        return outcome

    def latest(self) -> Sample | None:
        """The newest message."""
        try:
            return self._samples[-1]
        except IndexError:
            return None

    def since(self, stamp: int) -> Sequence[Sample]:
        """The messages with this stamp or a later one, oldest first."""
        samples = self.samples()
        return samples[bisect_left(samples, stamp, key=_stamp) :]

    def between(self, first: int, last: int) -> Sequence[Sample]:
        """The messages with stamps from `first` to `last`, both included, oldest first."""
        samples = self.samples()
        begin = bisect_left(samples, first, key=_stamp)
        return samples[begin : bisect_right(samples, last, begin, key=_stamp)]

    def samples(self) -> Sequence[Sample]:
        """All messages, oldest first."""
        for _ in range(_READS_MAX):
            try:
                return tuple(self._samples)
            except RuntimeError:  # the inserting thread came in between
                continue
        raise RuntimeError(f"a buffer changed {_READS_MAX} times while it was read")

    def clear(self) -> None:
        """Drop all messages and forget the time; counters stay."""
        self._drop_all()
        self.clock.forget()

    def change_bounds(self, bounds: BufferBounds, latched: bool, duplicates: str, jump: str) -> None:
        """Change bounds and policies; what fits stays, the oldest messages leave."""
        self.latched = latched
        self.duplicate_policy = duplicates
        self._window_ns = FOREVER_NS if latched else int(bounds.seconds * 1e9)
        self.clock.change(self._window_ns, jump, not latched)
        self._bytes_max = bounds.bytes
        self._count_max = bounds.count
        if self._samples:
            self._evict()

    def share(self, budget: _Budget) -> None:
        """Count the buffer's bytes in another budget from now on."""
        self._budget.bytes -= self.bytes
        self._budget = budget
        budget.bytes += self.bytes

    def drop_oldest(self) -> None:
        """Drop the oldest message for the sake of the process's bytes."""
        self._drop()
        self.evicted_process += 1

    def counters(self) -> Mapping[str, int]:
        """The messages and bytes held and every counter, as `/status` shows them."""
        held = {"messages": len(self._samples), "bytes": self.bytes, "kept": self.kept}
        return held | {name: getattr(self, name) for name in COUNTERS}

    def _place(self, sample: Sample) -> str:
        """Insert or refuse a message that is not simply the next one."""
        verdict = self.clock.judge(sample, self.received)
        if verdict is NEXT:
            self._samples.append(sample)
            return KEPT
        if verdict is JUMPED:
            self.jumps += 1
            self._drop_all()
            self._samples.append(sample)
        elif verdict is LATE:
            self.late += 1
        elif verdict is AHEAD:
            self.ahead += 1
        else:
            return self._put_between(sample)
        return verdict

    def _put_between(self, sample: Sample) -> str:
        samples = self._samples
        stamp = sample.stamp
        place = bisect_right(samples, stamp, key=_stamp)
        if self.duplicate_policy == DUPLICATES_DROP:
            for index in range(place - 1, max(place - 1 - DUPLICATES_COMPARED_MAX, -1), -1):
                known = samples[index]
                if known.stamp != stamp:
                    break
                if known.data == sample.data:
                    self.duplicates += 1
                    return DUPLICATE
        samples.insert(place, sample)
        if stamp == self.clock.newest:
            return KEPT
        self.disordered += 1
        return DISORDERED

    def _evict(self) -> None:
        samples = self._samples
        oldest = self.clock.newest - self._window_ns
        while samples[0][0] < oldest:
            self._drop()
            self.evicted_seconds += 1
        while self.bytes > self._bytes_max:
            self._drop()
            self.evicted_bytes += 1
        while len(samples) > self._count_max:
            self._drop()
            self.evicted_count += 1

    def _drop_all(self) -> None:
        self.cleared += len(self._samples)
        self._samples.clear()
        self._budget.bytes -= self.bytes
        self.bytes = 0

    def _drop(self) -> None:
        size = len(self._samples.popleft()[2])
        self.bytes -= size
        self._budget.bytes -= size


class BufferPool:
    """The buffers of a process by topic; those that are not latched hold at most `bytes_max` together.

    When that is exceeded, the oldest messages of the buffer that holds most leave first.
    """

    def __init__(self, bytes_max: int) -> None:
        self._budget = _Budget(bytes_max, [])
        self._buffers: dict[str, RingBuffer] = {}

    @property
    def buffers(self) -> Mapping[str, RingBuffer]:
        """A live view: topic -> buffer."""
        return MappingProxyType(self._buffers)

    @property
    def bytes(self) -> int:
        """The bytes that all buffers but the latched ones hold."""
        return self._budget.bytes

    def limit(self, bytes_max: int) -> None:
        """Change the bound of all buffers together."""
        self._budget.bytes_max = bytes_max
        if self._budget.bytes > bytes_max:
            self._budget.relieve()

    def make(
        self,
        name: str,
        bounds: BufferBounds,
        latched: bool = False,
        duplicates: str = DUPLICATES_DROP,
        jump: str = JUMP_RESTART,
    ) -> RingBuffer:
        """A new, empty buffer for a topic; ValueError when the topic has one."""
        if name in self._buffers:
            raise ValueError(f"{name} has a buffer already; remove it first")
        buffer = RingBuffer(bounds, latched, duplicates, jump, None if latched else self._budget)
        self._buffers[name] = buffer
        if not latched:
            self._budget.buffers.append(buffer)
        return buffer

    def change_bounds(self, name: str, bounds: BufferBounds, latched: bool, duplicates: str, jump: str) -> RingBuffer:
        """Change bounds and policies of a topic's buffer, which keeps what fits; KeyError when it has none."""
        buffer = self._buffers[name]
        if latched != buffer.latched:
            others = [other for other in self._budget.buffers if other is not buffer]
            self._budget.buffers = others if latched else [*others, buffer]
            buffer.share(_Budget(FOREVER_NS, []) if latched else self._budget)
        buffer.change_bounds(bounds, latched, duplicates, jump)
        if self._budget.bytes > self._budget.bytes_max:
            self._budget.relieve()
        return buffer

    def remove(self, name: str) -> None:
        """Remove a topic's buffer and what it holds; nothing happens when it has none."""
        buffer = self._buffers.pop(name, None)
        if buffer is None:
            return
        buffer.clear()
        self._budget.buffers = [other for other in self._budget.buffers if other is not buffer]

    def snapshot(self) -> Mapping[str, Mapping[str, int]]:
        """Topic -> its buffer's counters, for `/status`."""
        return {name: buffer.counters() for name, buffer in list(self._buffers.items())}
