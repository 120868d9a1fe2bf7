"""Batches: what goes in comes out, what is damaged is named, what was seen is dropped."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.mqtt.core.batches import (
    MISSING_MAX,
    SESSIONS_MAX,
    BatchError,
    SeenBatches,
    decode_batch,
    encode_batch,
)

NUMBERS = st.integers(0, 2**64 - 1)


@given(NUMBERS, NUMBERS, st.lists(st.binary(max_size=200), max_size=20))
def test_a_batch_comes_out_as_it_went_in(session: int, sequence: int, messages: list[bytes]) -> None:
    batch = decode_batch(encode_batch(session, sequence, messages))
    assert (batch.session, batch.sequence, list(batch.messages)) == (session, sequence, messages)


@given(st.lists(st.binary(max_size=50), min_size=1, max_size=5), st.data())
def test_every_shortened_batch_is_refused(messages: list[bytes], data: st.DataObject) -> None:
    batch = encode_batch(1, 2, messages)
    with pytest.raises(BatchError):
        decode_batch(batch[: data.draw(st.integers(0, len(batch) - 1))])


@given(st.binary(max_size=200))
def test_arbitrary_bytes_are_a_batch_or_refused(data: bytes) -> None:
    try:
        batch = decode_batch(data)
    except BatchError:
        return
    assert encode_batch(batch.session, batch.sequence, batch.messages) == data


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "shorter than its head"),
        (b"XXXX" + bytes(20), "instead of b'RKF1'"),
        (encode_batch(1, 1, [b"abc"]) + b"x", "1 bytes follow the last of 1 messages"),
        (encode_batch(1, 1, [b"abc"])[:-1], "message 1 of 1 ends at byte"),
        (encode_batch(1, 1, [b"a", b"b"])[:-5], "before message 2 of 2"),
        (encode_batch(1, 1, [b""] * 20_001), "a batch of 20001 messages; send at most 20000 in one"),
    ],
)
def test_the_refusal_says_what_is_wrong(data: bytes, words: str) -> None:
    with pytest.raises(BatchError, match=words):
        decode_batch(data)


def test_the_layout_is_the_one_of_the_contract() -> None:
    assert encode_batch(1, 2, [b"ab"]) == (
        b"RKF1" + (1).to_bytes(8, "little") + (2).to_bytes(8, "little") + b"\x01\0\0\0" + b"\x02\0\0\0ab"
    )


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 30)), max_size=100))
def test_every_batch_is_fresh_once(arrivals: list[tuple[int, int]]) -> None:
    seen = SeenBatches()
    first = {}
    known = set()
    for session, sequence in arrivals:
        first.setdefault(session, sequence)
        expected = (session, sequence) not in known and sequence >= first[session]
        assert seen.fresh(session, sequence) == expected
        known.add((session, sequence))
    assert seen.duplicates + len({a for a in known if a[1] >= first[a[0]]}) == len(arrivals)


def test_missing_batches_are_counted_until_they_come() -> None:
    seen = SeenBatches()
    assert [seen.fresh(7, n) for n in (0, 3, 1)] == [True, True, True]
    assert seen.missing == 1
    assert seen.fresh(7, 2)
    assert seen.missing == 0


def test_memory_is_bounded() -> None:
    seen = SeenBatches()
    for session in range(3 * SESSIONS_MAX):
        assert seen.fresh(session, 0)
        assert seen.fresh(session, 10 * MISSING_MAX)
    assert seen.missing <= SESSIONS_MAX * MISSING_MAX
