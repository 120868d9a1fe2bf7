"""The ring buffer keeps order and bounds whatever comes, in whatever order."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robotkube.domain.buffers import RingBuffer, Sample

inputs = st.lists(st.tuples(st.integers(0, 5_000), st.integers(0, 50)), max_size=80)
MS = 1_000_000


@given(inputs, st.integers(1, 400), st.integers(1, 20), st.booleans())
def test_bounds_and_order_hold(items: list[tuple[int, int]], bytes_max: int, count_max: int, latched: bool) -> None:
    buffer = RingBuffer(1.0, bytes_max, count_max, latched)
    newest = 0
    for stamp, size in items:
        buffer.insert(Sample(stamp * MS, 0, bytes(size)))
        kept = buffer.since(0)
        stamps = [sample.stamp for sample in kept]
        newest = max(newest, *stamps, 0)
        assert stamps == sorted(stamps)
        assert len(kept) == len(buffer) <= count_max
        assert sum(len(sample.data) for sample in kept) == buffer.bytes <= bytes_max
        if stamps and not latched:
            assert stamps[-1] - stamps[0] <= 1000 * MS
    assert buffer.late == 0 or not latched


@given(inputs)
def test_within_generous_bounds_it_is_a_sorted_window(items: list[tuple[int, int]]) -> None:
    buffer = RingBuffer(1.0, 10**6, 10**6)
    kept: list[int] = []
    for stamp, size in items:
        buffer.insert(Sample(stamp, stamp, bytes(size)))
        kept.append(stamp)
    assert [sample.stamp for sample in buffer.since(0)] == sorted(kept)
    assert buffer.evicted == 0


def test_late_and_disordered_are_told_apart() -> None:
    buffer = RingBuffer(1.0, 1000, 1000)
    for stamp in (5000, 4500, 3999, 5000):
        buffer.insert(Sample(stamp * MS, 0, b"x"))
    assert (buffer.late, buffer.disordered, len(buffer)) == (1, 1, 3)


def test_a_latched_buffer_keeps_what_was_said_once() -> None:
    buffer = RingBuffer(1.0, 1000, 1, latched=True)
    buffer.insert(Sample(0, 0, b"transform"))
    assert len(buffer.since(0)) == 1
