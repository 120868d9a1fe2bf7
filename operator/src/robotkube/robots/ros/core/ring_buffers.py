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
from typing import NamedTuple

KEPT, LATE, DUPLICATE, JUMPED = "kept", "late", "duplicate", "jumped"
"""The outcomes of an insertion: kept; older (or wrongly newer) than the window; known already; time jumped."""

DUPLICATES_DROP, DUPLICATES_KEEP = "drop", "keep"
JUMP_RESTART, JUMP_KEEP = "restart", "keep"

COUNT_DEFAULT = 100_000
DUPLICATES_COMPARED_MAX = 100
OUTLIERS_MAX = 3
"""Messages in a row, all far ahead or all far behind, that are a jump wherever they are."""
BEHIND_COUNT = 10
BEHIND_NS = 1_000_000_000
"""Messages in a row, and the least time they span, all behind the newest: time went back by less than the window."""

COUNTERS = (
    "received", "late", "disordered", "duplicates", "jumps", "cleared",
    "evicted_seconds", "evicted_bytes", "evicted_count", "evicted_process",
)  # fmt: skip

_FOREVER = 1 << 80
_RELIEF_SHARE = 64
_READS_MAX = 100

_stamp = attrgetter("stamp")


class Sample(NamedTuple):
    """One message: when it was measured (header stamp, else reception) and received, ns since 1970, and its CDR bytes.

    A named tuple, because it costs a quarter of a frozen dataclass and the garbage collector lets go of it.
    """

    stamp: int
    received: int
    data: bytes


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

    Counters, all of which only grow: `received` = kept + late + duplicates; of those kept, `disordered` came after a
    newer one; `evicted_*` and `cleared` left because of age, bytes, count, the process's bytes or a jump; `jumps`.
    A `latched` buffer has no window and no part in the process's bytes: its publishers send a message once.
    """

    __slots__ = (
        *COUNTERS, "_ahead", "_behind_at", "_behind_count", "_behind_since", "_budget", "_bytes_max", "_count_max",
        "_newest", "_newest_received", "_samples", "_suspect", "_suspect_at", "_suspects", "_window_ns", "bytes",
        "duplicate_policy", "jump_policy", "latched",
    )  # fmt: skip

    def __init__(
        self,
        bounds: BufferBounds,
        latched: bool = False,
        duplicates: str = DUPLICATES_DROP,
        jump: str = JUMP_RESTART,
        budget: _Budget | None = None,
    ) -> None:
        self.latched = latched
        self.duplicate_policy = duplicates
        self.jump_policy = jump
        self._window_ns = _FOREVER if latched else int(bounds.seconds * 1e9)
        self._bytes_max = bounds.bytes
        self._count_max = bounds.count
        self._budget = budget or _Budget(_FOREVER, [])
        self._samples: deque[Sample] = deque()
        self.bytes = self.received = self.late = self.disordered = self.duplicates = self.jumps = self.cleared = 0
        self.evicted_seconds = self.evicted_bytes = self.evicted_count = self.evicted_process = 0
        self._newest = -_FOREVER
        self._ahead = _FOREVER
        self._newest_received = 0
        self._suspect = Sample(0, 0, b"")
        self._suspects = 0
        self._suspect_at = self._behind_at = self._behind_count = self._behind_since = -1

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def kept(self) -> int:
        """The number of messages that were inserted."""
        return self.received - self.late - self.duplicates

    def insert(self, sample: Sample) -> str:
        """Insert a message; older ones leave as the bounds ask. Returns KEPT, LATE, DUPLICATE or JUMPED (inserted,
        too)."""
        stamp, received, data = sample
        self.received += 1
        outcome = KEPT
        samples = self._samples
        if self._newest < stamp <= self._ahead:
            samples.append(sample)
            self._newest = stamp
            self._newest_received = received
            self._ahead = stamp + self._window_ns
        else:
            outcome = self._place(sample)
            if outcome is LATE or outcome is DUPLICATE:
                return outcome
        size = len(data)
        budget = self._budget
        self.bytes += size
        budget.bytes += size
        if (
            samples[0][0] < self._newest - self._window_ns  # the stamp; by its place it takes half as long
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
        self.cleared += len(self._samples)
        self._samples.clear()
        self._budget.bytes -= self.bytes
        self.bytes = 0
        self._newest = -_FOREVER
        self._ahead = _FOREVER

    def change_bounds(self, bounds: BufferBounds, latched: bool, duplicates: str, jump: str) -> None:
        """Change bounds and policies; what fits stays, the oldest messages leave."""
        self.latched = latched
        self.duplicate_policy = duplicates
        self.jump_policy = jump
        self._window_ns = _FOREVER if latched else int(bounds.seconds * 1e9)
        self._bytes_max = bounds.bytes
        self._count_max = bounds.count
        if self._newest > -_FOREVER:
            self._ahead = self._newest + self._window_ns
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
        """Insert or drop a message that is not simply the next one."""
        stamp = sample.stamp
        if stamp > self._newest:
            waited = sample.received - self._newest_received
            if stamp - self._newest - waited <= self._window_ns:  # silence: the clock of reception went on as well
                return self._append(sample)
            return self._restart(sample) if self._again(sample) else self._drop_late()
        if stamp < self._newest and self._runs_behind(sample) and self.jump_policy == JUMP_RESTART:
            return self._restart(sample)
        if stamp < self._newest - self._window_ns:
            jumped = self._again(sample) and self.jump_policy == JUMP_RESTART
            return self._restart(sample) if jumped else self._drop_late()
        return self._put_between(sample)

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
        self.disordered += stamp < self._newest
        return KEPT

    def _append(self, sample: Sample) -> str:
        self._samples.append(sample)
        self._newest = sample.stamp
        self._newest_received = sample.received
        self._ahead = sample.stamp + self._window_ns
        return KEPT

    def _restart(self, sample: Sample) -> str:
        self.clear()
        self.jumps += 1
        self._append(sample)
        return JUMPED

    def _drop_late(self) -> str:
        self.late += 1
        return LATE

    def _again(self, sample: Sample) -> bool:
        """True when the message before this one was far off in the same way: then neither is an outlier.

        In the same way: near to this one, or as much earlier as it was received earlier; or several on one side.
        """
        before = self._suspect
        in_a_row = self._suspect_at == self.received - 1
        self._suspect = sample
        self._suspect_at = self.received
        apart = sample.stamp - before.stamp
        waited = sample.received - before.received
        if not in_a_row or (before.stamp > self._newest) != (sample.stamp > self._newest):
            self._suspects = 1
            return False
        if not apart and before.data == sample.data:
            return False
        self._suspects += 1
        alike = abs(apart) <= self._window_ns or abs(apart - waited) <= self._window_ns
        return alike or self._suspects >= OUTLIERS_MAX

    def _runs_behind(self, sample: Sample) -> bool:
        """True when messages have been behind the newest for so long that it is not a matter of order any more."""
        if self._behind_at != self.received - 1:
            self._behind_since = sample.received
            self._behind_count = 0
        self._behind_at = self.received
        self._behind_count += 1
        lasted = sample.received - self._behind_since >= BEHIND_NS and self._behind_count >= BEHIND_COUNT
        return lasted and not self.latched

    def _evict(self) -> None:
        samples = self._samples
        oldest = self._newest - self._window_ns
        while samples[0][0] < oldest:
            self._drop()
            self.evicted_seconds += 1
        while self.bytes > self._bytes_max:
            self._drop()
            self.evicted_bytes += 1
        while len(samples) > self._count_max:
            self._drop()
            self.evicted_count += 1

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
            buffer.share(_Budget(_FOREVER, []) if latched else self._budget)
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
