"""The ring buffer as simply as it can be said: a list that is sorted and searched. And random messages for both."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import product

from robotkube.robots.ros.core.ring_buffers import (
    AHEAD,
    DISORDERED,
    DUPLICATE,
    DUPLICATES_DROP,
    DUPLICATES_KEEP,
    JUMP_KEEP,
    JUMP_RESTART,
    JUMPED,
    KEPT,
    LATE,
    BufferBounds,
    Sample,
)
from robotkube.robots.ros.core.source_clocks import BEHIND_COUNT, BEHIND_NS, OUTLIERS_MAX

KNOWN_POLICIES = list(product([False, False, True], [DUPLICATES_DROP, DUPLICATES_KEEP], [JUMP_RESTART, JUMP_KEEP]))
MS = 1_000_000


class ModelBuffer:
    """Keeps the whole history and works everything out from it."""

    def __init__(self, bounds: BufferBounds, latched: bool, duplicates: str, jump: str) -> None:
        self._bind(bounds, latched, duplicates, jump)
        self.kept: list[Sample] = []
        self.history: list[Sample] = []
        self.newest: Sample | None = None
        self.behind: list[int] = []
        self.far: list[Sample] = []
        self.counters = dict.fromkeys(
            ("late", "ahead", "duplicates", "disordered", "jumps", "cleared", "evicted_seconds", "evicted_bytes",
             "evicted_count", "evicted_process"), 0,
        )  # fmt: skip

    def change_bounds(self, bounds: BufferBounds, latched: bool, duplicates: str, jump: str) -> None:
        self._bind(bounds, latched, duplicates, jump)
        self._evict_all()

    def _bind(self, bounds: BufferBounds, latched: bool, duplicates: str, jump: str) -> None:
        self.bounds, self.latched, self.duplicates, self.jump = bounds, latched, duplicates, jump
        self.window = 10**30 if latched else int(bounds.seconds * 1e9)

    def insert(self, sample: Sample) -> str:
        self.history.append(sample)
        newest = self.newest
        before = self.far
        self.far = []
        self.behind = [*self.behind, sample.received] if newest and sample.stamp < newest.stamp else []
        if newest is None:
            return self._keep(sample)
        ahead = sample.stamp - newest.stamp
        unexplained = ahead - (sample.received - newest.received)
        too_far_ahead = ahead > self.window and unexplained > self.window
        if self._lasts_behind() and self.jump == JUMP_RESTART:
            return self._restart(sample)
        if too_far_ahead or -ahead > self.window:
            again = self._confirms(before, sample, too_far_ahead)
            if again and (too_far_ahead or self.jump == JUMP_RESTART):
                return self._restart(sample)
            self.counters["ahead" if too_far_ahead else "late"] += 1
            return AHEAD if too_far_ahead else LATE
        known = any(kept.stamp == sample.stamp and kept.data == sample.data for kept in self.kept)
        if self.duplicates == DUPLICATES_DROP and known:
            self.counters["duplicates"] += 1
            return DUPLICATE
        self.counters["disordered"] += ahead < 0
        self._keep(sample)
        return DISORDERED if ahead < 0 else KEPT

    def _confirms(self, before: list[Sample], sample: Sample, ahead: bool) -> bool:
        """`before`: those far off in a row up to now, on one side."""
        assert self.newest
        if before and (before[-1].stamp > self.newest.stamp) != ahead:
            before = []
        self.far = [*before, sample]
        if not before:
            return False
        last = before[-1]
        if (last.stamp, last.data) == (sample.stamp, sample.data):
            self.far = [*before[:-1], sample]
            return False
        apart = sample.stamp - last.stamp
        near = abs(apart) <= self.window or abs(apart - (sample.received - last.received)) <= self.window
        return near or len(self.far) >= OUTLIERS_MAX

    def _lasts_behind(self) -> bool:
        lasted = len(self.behind) >= BEHIND_COUNT and self.behind[-1] - self.behind[0] >= BEHIND_NS
        return lasted and not self.latched

    def _restart(self, sample: Sample) -> str:
        self.counters["jumps"] += 1
        self.counters["cleared"] += len(self.kept)
        self.kept = []
        self.newest = None
        self._keep(sample)
        return JUMPED

    def _keep(self, sample: Sample) -> str:
        if self.newest is None or sample.stamp > self.newest.stamp:
            self.newest = sample
        self.kept = sorted([*self.kept, sample], key=lambda kept: kept.stamp)
        self._evict_all()
        return KEPT

    def _evict_all(self) -> None:
        self._evict("evicted_seconds", lambda: self.kept[0].stamp < self.newest.stamp - self.window)
        self._evict("evicted_bytes", lambda: self.bytes() > self.bounds.bytes)
        self._evict("evicted_count", lambda: len(self.kept) > self.bounds.count)

    def _evict(self, counter: str, too_much: object) -> None:
        while self.kept and too_much():
            self.kept.pop(0)
            self.counters[counter] += 1

    def bytes(self) -> int:
        return sum(len(kept.data) for kept in self.kept)


class ModelPool:
    """Buffers that have a bound together; the last in the order of names with most bytes does not matter: the first."""

    def __init__(self, bytes_max: int) -> None:
        self.bytes_max = bytes_max
        self.buffers: dict[str, ModelBuffer] = {}

    def make(self, name: str, bounds: BufferBounds, latched: bool) -> None:
        self.buffers[name] = ModelBuffer(bounds, latched, DUPLICATES_DROP, JUMP_RESTART)

    def bytes(self) -> int:
        return sum(buffer.bytes() for buffer in self.buffers.values() if not buffer.latched)

    def insert(self, name: str, sample: Sample) -> str:
        outcome = self.buffers[name].insert(sample)
        if self.bytes() > self.bytes_max:
            while self.bytes() > self.bytes_max - self.bytes_max // 64:
                most = max((b for b in self.buffers.values() if not b.latched), key=ModelBuffer.bytes)
                most.kept.pop(0)
                most.counters["evicted_process"] += 1
        return outcome


def random_messages(draw: random.Random, count: int = 60) -> Iterator[Sample]:
    """Mostly in order; now and then older, repeated, far off once, silent for long, or jumping; receive times grow."""
    stamp = 100_000
    received = 100_000
    sent = []
    for _ in range(count):
        kind = draw.choices(
            ["next", "older", "repeat", "outlier", "silence", "jump", "same"], [30, 6, 5, 3, 1, 1.5, 2]
        )[0]
        step = draw.choice([1, 10, 100, 300])
        received += step
        one = stamp
        if kind == "silence":
            stamp, received = stamp + 20_000, received + 20_000
        elif kind == "jump":
            stamp += draw.choice([-1, 1]) * draw.choice([700, 2_000, 50_000])
        if kind in ("next", "silence", "jump"):
            one = stamp = stamp + step
        elif kind == "older":
            one = stamp - draw.randrange(1_500)
        elif kind == "outlier":
            one = stamp + draw.choice([-1, 1]) * draw.randrange(4_000, 90_000)
        data = bytes([draw.randrange(256)]) * draw.randrange(60)
        sample = Sample(one * MS, received * MS, data)
        if kind == "repeat" and sent:
            again = draw.choice(sent[-5:])
            sample = Sample(again.stamp, received * MS, again.data)
        sent.append(sample)
        yield sample
