"""The ring buffer keeps order, bounds and counts whatever comes, in whatever order; and what it makes of time."""

from __future__ import annotations

import random
import resource
import threading
import tracemalloc
from pathlib import Path

import pytest

from robotkube.robots.ros.core.ring_buffers import (
    AHEAD,
    DISORDERED,
    DUPLICATE,
    DUPLICATES_KEEP,
    JUMP_KEEP,
    JUMPED,
    KEPT,
    LATE,
    BufferBounds,
    BufferPool,
    RingBuffer,
    Sample,
)
from robotkube.robots.ros.core.source_clocks import BEHIND_COUNT
from tests.stages.examples import EXAMPLES
from tests.stages.ros.buffer_model import KNOWN_POLICIES, ModelBuffer, ModelPool, random_messages

S, MS = 1_000_000_000, 1_000_000
CASES = [max(EXAMPLES, 40), pytest.param(5000, marks=pytest.mark.thorough)]  # enough for every outcome


def sample(stamp_ms: int, received_ms: int | None = None, data: bytes = b"x") -> Sample:
    return Sample(stamp_ms * MS, (stamp_ms if received_ms is None else received_ms) * MS, data)


def stamps(buffer: RingBuffer) -> list[int]:
    return [kept.stamp // MS for kept in buffer.samples()]


def filled(*stamps_ms: int, jump: str = "restart", count: int = 1000) -> tuple[RingBuffer, list[str]]:
    """A buffer of one second; every message is received 1 ms after the one before."""
    buffer = RingBuffer(BufferBounds(1.0, 10**6, count), jump=jump)
    return buffer, [buffer.insert(sample(stamp, 5000 + n, b"%d" % n)) for n, stamp in enumerate(stamps_ms)]


# against the model ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", CASES)
def test_it_does_what_a_plain_list_would(count: int) -> None:
    """Random order, duplicates, outliers, jumps, silence and bounds, against a model that sorts and searches a list."""
    seen = dict.fromkeys((KEPT, DISORDERED, LATE, AHEAD, DUPLICATE, JUMPED), 0)
    for seed in range(count):
        draw = random.Random(seed)  # noqa: S311 - the same cases every time
        bounds = BufferBounds(draw.choice([0.5, 1.0, 3.0]), draw.choice([200, 2000, 10**6]), draw.choice([1, 7, 1000]))
        latched, duplicates, jump = draw.choice(KNOWN_POLICIES)
        buffer = RingBuffer(bounds, latched, duplicates, jump)
        model = ModelBuffer(bounds, latched, duplicates, jump)
        for message in random_messages(draw):
            outcome = buffer.insert(message)
            assert outcome == model.insert(message), (seed, message)
            assert buffer.samples() == tuple(model.kept), (seed, message)
            seen[outcome] += 1
        assert {name: buffer.counters()[name] for name in model.counters} == model.counters, seed
        check_sums(buffer)
        first, last = sorted(draw.choice(model.history).stamp for _ in range(2))
        assert list(buffer.between(first, last)) == [kept for kept in model.kept if first <= kept.stamp <= last]
        assert list(buffer.since(first)) == [kept for kept in model.kept if kept.stamp >= first]
        assert buffer.latest() == (model.kept[-1] if model.kept else None)
    assert min(seen.values()) > count / 10, "the random messages must have led to every outcome"


@pytest.mark.parametrize("count", CASES)
def test_other_bounds_take_what_does_not_fit_and_nothing_else(count: int) -> None:
    """Bounds and policies that change between random messages, against the model."""
    kept_over = 0
    for seed in range(count):
        draw = random.Random(seed)  # noqa: S311 - the same cases every time
        terms = random_terms(draw)
        buffer = RingBuffer(*terms)
        model = ModelBuffer(*terms)
        for message in random_messages(draw):
            if draw.random() < 0.1:
                terms = random_terms(draw)
                buffer.change_bounds(*terms)
                model.change_bounds(*terms)
                assert buffer.samples() == tuple(model.kept), seed
                kept_over += len(buffer) > 1
            assert buffer.insert(message) == model.insert(message), (seed, message)
            assert buffer.samples() == tuple(model.kept), (seed, message)
        assert {name: buffer.counters()[name] for name in model.counters} == model.counters, seed
        check_sums(buffer)
    assert kept_over > count


def random_terms(draw: random.Random) -> tuple[BufferBounds, bool, str, str]:
    bounds = BufferBounds(draw.choice([0.5, 1.0, 3.0]), draw.choice([200, 2000, 10**6]), draw.choice([1, 7, 1000]))
    return bounds, *draw.choice(KNOWN_POLICIES)


def test_a_topic_of_a_pool_becomes_latched_and_back_with_its_bytes() -> None:
    pool = BufferPool(100)
    wide = BufferBounds(60.0, 1000)
    for name in "ab":
        buffer = pool.make(name, wide)
        for stamp in range(4):
            buffer.insert(sample(stamp, data=b"0123456789"))
    assert (pool.bytes, pool.change_bounds("a", wide, True, "drop", "restart"), pool.bytes) == (
        80,
        pool.buffers["a"],
        40,
    )
    for stamp in range(4, 14):
        pool.buffers["a"].insert(sample(stamp, data=b"0123456789"))
    assert (len(pool.buffers["a"]), pool.bytes) == (14, 40), "no part in the process's bytes"
    pool.change_bounds("a", wide, False, "drop", "restart")
    assert pool.bytes <= 100
    assert (len(pool.buffers["a"]), len(pool.buffers["b"])) == (5, 4), "from whoever holds most"
    with pytest.raises(KeyError):
        pool.change_bounds("c", wide, False, "drop", "restart")


def check_sums(buffer: RingBuffer) -> None:
    """Every message received is somewhere."""
    numbers = buffer.counters()
    assert numbers["received"] == sum(numbers[name] for name in ("kept", "late", "ahead", "duplicates"))
    left = sum(numbers[name] for name in numbers if name.startswith("evicted_")) + numbers["cleared"]
    assert numbers["kept"] == numbers["messages"] + left
    assert numbers["bytes"] == sum(len(kept.data) for kept in buffer.samples())


@pytest.mark.parametrize("count", CASES)
def test_a_pool_takes_from_whoever_holds_most(count: int) -> None:
    """Several topics in random order under a bound of the process, against the model; latched topics keep theirs."""
    evicted = 0
    for seed in range(count):
        draw = random.Random(seed)  # noqa: S311 - the same cases every time
        bytes_max = draw.choice([100, 1000, 5000])
        pool = BufferPool(bytes_max)
        model = ModelPool(bytes_max)
        for name in "abc":
            bounds = BufferBounds(2.0, 10**6)
            pool.make(name, bounds, latched=name == "c")
            model.make(name, bounds, latched=name == "c")
        for message in random_messages(draw):
            name = draw.choice("aaabc")
            assert pool.buffers[name].insert(message) == model.insert(name, message), (seed, name, message)
            assert pool.bytes == model.bytes() <= bytes_max, seed
        for name in "abc":
            assert pool.buffers[name].samples() == tuple(model.buffers[name].kept), (seed, name)
            check_sums(pool.buffers[name])
        assert pool.buffers["c"].evicted_process == 0
        evicted += sum(numbers["evicted_process"] for numbers in pool.snapshot().values())
    assert evicted > count


def test_a_topic_that_is_removed_gives_its_bytes_back() -> None:
    pool = BufferPool(10)
    first, _ = pool.make("/a", BufferBounds(1, 100)), pool.make("/b", BufferBounds(1, 100))
    first.insert(sample(1, data=bytes(8)))
    pool.remove("/a")
    pool.remove("/a")
    assert (pool.bytes, list(pool.buffers)) == (0, ["/b"])
    pool.buffers["/b"].insert(sample(1, data=bytes(10)))
    assert len(pool.buffers["/b"]) == 1
    with pytest.raises(ValueError, match="/b has a buffer already"):
        pool.make("/b", BufferBounds(1, 1))


# time -----------------------------------------------------------------------------------------------------------------


def test_out_of_order_is_put_in_order_and_late_is_dropped() -> None:
    buffer, outcomes = filled(5000, 4500, 5100, 4000)
    assert outcomes == [KEPT, DISORDERED, KEPT, LATE]
    assert (stamps(buffer), buffer.disordered, buffer.late) == ([4500, 5000, 5100], 1, 1)


@pytest.mark.parametrize(("outlier", "outcome"), [(1000, LATE), (9000, AHEAD)])
def test_one_outlier_moves_nothing(outlier: int, outcome: str) -> None:
    """Neither a message far behind nor one far ahead clears the buffer or moves its window."""
    buffer, outcomes = filled(5000, 5010, outlier, 5020, outlier + 5, 5030)
    assert outcomes == [KEPT, KEPT, outcome, KEPT, outcome, KEPT]
    assert (stamps(buffer), buffer.jumps) == ([5000, 5010, 5020, 5030], 0)


@pytest.mark.parametrize(("there", "first"), [(1000, LATE), (9000, AHEAD)])
def test_two_in_a_row_are_a_jump(there: int, first: str) -> None:
    buffer, outcomes = filled(5000, 5010, there, there + 10, there + 20)
    assert outcomes == [KEPT, KEPT, first, JUMPED, KEPT]
    assert (stamps(buffer), buffer.jumps, buffer.cleared) == ([there + 10, there + 20], 1, 2)


def test_two_outliers_of_different_times_are_no_jump() -> None:
    assert filled(5000, 1000, 9000, 3000, 5010)[1] == [KEPT, LATE, AHEAD, LATE, KEPT]


def test_three_on_one_side_are_a_jump_wherever_they_are() -> None:
    assert filled(5000, 9000, 29000, 60000, 60010)[1] == [KEPT, AHEAD, AHEAD, JUMPED, KEPT]


def test_a_topic_slower_than_the_window_jumps_with_its_clock() -> None:
    """A message every 15 s, a window of 1 s, and a clock that is put forward by an hour."""
    buffer = RingBuffer(BufferBounds(1.0, 1000))
    hour = 3_600_000
    times = [(0, 0), (15_000, 15_000), (hour + 30_000, 30_000), (hour + 45_000, 45_000), (hour + 60_000, 60_000)]
    assert [buffer.insert(sample(*pair)) for pair in times] == [KEPT, KEPT, AHEAD, JUMPED, KEPT]


def test_one_outlier_sent_twice_is_no_jump() -> None:
    buffer, _ = filled(5000)
    assert [buffer.insert(sample(stamp)) for stamp in (1000, 1000, 1000, 1000, 5010)] == [LATE] * 4 + [KEPT]


def test_kept_time_does_not_go_back_but_forward() -> None:
    """Policy keep: what is behind the window stays late; ahead there is nothing to keep, so it goes on there."""
    assert filled(5000, 1000, 1010, 1020, 5010, jump=JUMP_KEEP)[1] == [KEPT, LATE, LATE, LATE, KEPT]
    assert filled(5000, 9000, 9010, 9020, jump=JUMP_KEEP)[1] == [KEPT, AHEAD, JUMPED, KEPT]


def test_silence_is_no_jump() -> None:
    """Nothing for a minute by the stamps, and by the clock of reception as well."""
    buffer = RingBuffer(BufferBounds(1.0, 1000))
    assert [buffer.insert(sample(stamp)) for stamp in (5000, 65000, 65010)] == [KEPT, KEPT, KEPT]
    assert (stamps(buffer), buffer.jumps, buffer.evicted_seconds) == ([65000, 65010], 0, 1)


def test_a_loop_shorter_than_the_window_is_a_jump() -> None:
    """A bag of 3 s in a loop and a window of 10 s: nothing is older than the window, but time went back."""
    buffer = RingBuffer(BufferBounds(10.0, 10**6))
    outcomes = [buffer.insert(sample(n % 30 * 100, n * 100, b"%d" % (n % 30))) for n in range(90)]
    assert outcomes[:30] == [KEPT] * 30
    assert outcomes.count(JUMPED) == buffer.jumps == 2
    assert outcomes[30 : 30 + BEHIND_COUNT] == [DUPLICATE] * BEHIND_COUNT
    assert outcomes[30 + BEHIND_COUNT] == JUMPED


def test_old_messages_that_come_in_a_burst_are_no_jump() -> None:
    """Those of an outage, 0.9 s of them at once behind the first new one."""
    buffer, outcomes = filled(5000, 6000, *range(5100, 6000, 10))
    assert outcomes == [KEPT, KEPT, *[DISORDERED] * 90]
    assert (buffer.jumps, buffer.disordered) == (0, 90)


# duplicates -----------------------------------------------------------------------------------------------------------


def test_duplicates_have_the_same_stamp_and_content() -> None:
    buffer = RingBuffer(BufferBounds(1.0, 1000))
    for stamp, data in ((1, b"a"), (2, b"b"), (1, b"a"), (1, b"c"), (2, b"b"), (2, b"a")):
        buffer.insert(sample(stamp, data=data))
    assert [(kept.stamp // MS, kept.data) for kept in buffer.samples()] == [
        (1, b"a"), (1, b"c"), (2, b"b"), (2, b"a"),
    ]  # fmt: skip
    assert buffer.duplicates == 2


def test_duplicates_are_kept_when_the_policy_says_so() -> None:
    buffer = RingBuffer(BufferBounds(1.0, 1000), duplicates=DUPLICATES_KEEP)
    assert [buffer.insert(sample(1)) for _ in range(3)] == [KEPT] * 3
    assert len(buffer) == 3


# bounds ---------------------------------------------------------------------------------------------------------------


def test_every_bound_has_its_counter() -> None:
    buffer = RingBuffer(BufferBounds(1.0, 50, 4))
    for stamp, size in ((1000, 1), (1100, 1), (1200, 1), (1300, 1), (1400, 1), (2250, 1), (2300, 49)):
        buffer.insert(sample(stamp, data=bytes(size)))
    assert (buffer.evicted_count, buffer.evicted_seconds, buffer.evicted_bytes) == (1, 2, 2)
    assert stamps(buffer) == [2250, 2300]


def test_a_latched_buffer_keeps_what_was_said_once() -> None:
    buffer = RingBuffer(BufferBounds(1.0, 1000, 2), latched=True)
    assert [buffer.insert(sample(stamp, data=b"%d" % stamp)) for stamp in (0, 10**9, 10**6)] == [KEPT, KEPT, DISORDERED]
    assert stamps(buffer) == [10**6, 10**9]


def test_full_rate_keeps_memory_at_its_window() -> None:
    """Vehicles at 100 Hz with windows of 10 s: after 12 s and after 30 s the same memory, in slots."""
    pool = BufferPool(10**9)
    vehicles = 4
    for vehicle in range(vehicles):
        pool.make(f"/vehicles/vehicle_{vehicle:02}/pose", BufferBounds(10.0, 50_000_000))
    tracemalloc.start()
    try:
        held = {}
        for step in range(3001):
            for buffer in pool.buffers.values():
                buffer.insert(Sample(step * 10 * MS, step * 10 * MS + 1, bytes(104)))
            if step in (1200, 3000):
                held[step] = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert held[1200] / (vehicles * 1001) < 450, "bytes per message of 104 bytes"
    assert abs(held[3000] - held[1200]) < 0.02 * held[1200]


@pytest.mark.thorough
def test_ten_minutes_at_full_rate_keep_memory() -> None:
    """15 vehicles' poses at 100 Hz and two vehicles' clouds at 10 Hz, windows of 10 s: what the process holds."""
    pool = BufferPool(10**9)
    poses = [pool.make(f"/vehicles/vehicle_{n:02}/pose", BufferBounds(10.0, 50_000_000)) for n in range(15)]
    clouds = [pool.make(f"/vehicles/vehicle_{n:02}/cloud", BufferBounds(10.0, 50_000_000)) for n in range(2)]
    held = {}
    for step in range(60_000):
        stamp = step * 10 * MS
        for buffer in poses:
            buffer.insert(Sample(stamp, stamp + MS, step.to_bytes(104, "little")))
        for buffer in clouds if step % 10 == 0 else ():
            buffer.insert(Sample(stamp, stamp + MS, b"\1" * 320_000))
        if step % 6_000 == 5_999:
            held[(step + 1) // 6_000] = resident_bytes()
    assert held[10] - held[2] <= 16 * 2**20, held
    assert pool.bytes == sum(buffer.bytes for buffer in pool.buffers.values())


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def test_readers_of_other_threads_see_whole_buffers() -> None:
    buffer = RingBuffer(BufferBounds(0.05, 10**6))
    done = threading.Event()
    wrong = []

    def read() -> None:
        while not done.is_set():
            seen = [kept.stamp for kept in buffer.since(0)]
            newest = buffer.latest()
            if seen != sorted(seen) or (newest and seen and newest.stamp < seen[-1]):
                wrong.append(seen)

    threads = [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    for step in range(20_000):
        buffer.insert(sample(step if step % 7 else step - 3, step, b"%d" % step))
    done.set()
    for thread in threads:
        thread.join(10)
    assert not wrong
    assert buffer.kept == 20_000
