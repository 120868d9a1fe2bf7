"""What a recording looks like, and that the comparison finds every way in which it can be wrong."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from robotkube.robots.recording.core.audits import add_up
from robotkube.robots.recording.core.documents import (
    Duplicates,
    Received,
    SegmentMessage,
    SegmentPlace,
    bucket_documents,
    index_document,
)
from robotkube.robots.recording.core.ledgers import (
    LATENCY_NS_MAX,
    LedgerLine,
    StoredMessage,
    compare,
    compare_topic,
    published_digest,
)
from robotkube.robots.recording.core.verification import examine
from robotkube.robots.recording.loops.reading import read_ledger

WINDOW = (100, 200)


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def line(number: int) -> LedgerLine:
    return LedgerLine(number, number, digest(str(number)))


def stored(number: int, text: str | None = None) -> StoredMessage:
    value = digest(str(number) if text is None else text)
    return StoredMessage("/p", number, value, value, 10)


GOOD_LINES = [line(n) for n in range(90, 211, 10)]
GOOD_STORED = [stored(n) for n in range(90, 211, 10)]


def test_equal_is_complete() -> None:
    comparison = compare_topic("/p", GOOD_LINES, GOOD_STORED, WINDOW)
    assert comparison.complete
    assert (comparison.published, comparison.stored) == (11, 11)


def test_outside_of_the_window_nothing_counts() -> None:
    comparison = compare_topic("/p", GOOD_LINES, [m for m in GOOD_STORED if 100 <= m.stamp <= 200], WINDOW)
    assert comparison.complete


def test_a_lost_message_is_named() -> None:
    comparison = compare_topic("/p", GOOD_LINES, [m for m in GOOD_STORED if m.stamp != 150], WINDOW)
    assert comparison.lost == (line(150),)
    assert not comparison.complete


def test_a_doubled_message_is_named() -> None:
    comparison = compare_topic("/p", GOOD_LINES, [*GOOD_STORED, stored(150), stored(150)], WINDOW)
    assert comparison.duplicates == (150, 150)
    assert comparison.lost == ()


def test_a_changed_message_is_named_once() -> None:
    changed = [m if m.stamp != 150 else stored(150, "other") for m in GOOD_STORED]
    comparison = compare_topic("/p", GOOD_LINES, changed, WINDOW)
    assert (comparison.mismatches, comparison.lost, comparison.unknown) == ((150,), (), ())


def test_bytes_that_differ_from_what_was_claimed_are_named() -> None:
    claimed = [m if m.stamp != 150 else replace(m, recorded_sha256=digest("x")) for m in GOOD_STORED]
    assert compare_topic("/p", GOOD_LINES, claimed, WINDOW).mismatches == (150,)


def test_an_invented_message_is_named() -> None:
    assert compare_topic("/p", GOOD_LINES, [*GOOD_STORED, stored(155)], WINDOW).unknown == (155,)


def test_an_unreadable_message_is_lost_and_named() -> None:
    broken = [m if m.stamp != 150 else replace(m, sha256="", problem="n/c: away") for m in GOOD_STORED]
    comparison = compare_topic("/p", GOOD_LINES, broken, WINDOW)
    assert (comparison.unreadable, comparison.lost) == (("n/c: away",), (line(150),))


def test_topics_without_ledger_are_named() -> None:
    comparison = compare("r", {"/p": GOOD_LINES}, [*GOOD_STORED, replace(stored(1), topic="/q")], WINDOW)
    assert comparison.complete
    assert comparison.without_ledger == ("/q",)
    assert not compare("r", {"/p": GOOD_LINES}, [], WINDOW).complete
    assert not compare("r", {}, GOOD_STORED, WINDOW).complete


messages = st.lists(
    st.builds(
        lambda topic, stamp, data: Received(topic, stamp, stamp + 1, hashlib.sha256(data).hexdigest(), data),
        st.sampled_from(["/a", "/b"]),
        st.integers(0, 5 * 10**9),
        st.binary(max_size=4),
    ),
    max_size=30,
    unique_by=lambda message: (message.topic, message.stamp, message.sha256),
)


@given(messages)
def test_buckets_hold_everything_once_and_are_named_by_content(items: list[Received]) -> None:
    buckets = bucket_documents("r", items)
    assert buckets == bucket_documents("r", list(reversed(items))) or len({m.stamp for m in items}) < len(items)
    assert len({bucket["_id"] for bucket in buckets}) == len(buckets)
    samples = [(b["topic"], s["stamp"], s["sha256"]) for b in buckets for s in b["samples"]]
    assert sorted(samples) == sorted((m.topic, m.stamp, m.sha256) for m in items)
    for bucket in buckets:
        assert bucket["_id"].startswith(f"r/{bucket['topic']}/{bucket['second']}/")
        assert {s["stamp"] // 10**9 for s in bucket["samples"]} == {bucket["second"]}


def test_index_entries_are_told_apart_when_stamps_are_equal() -> None:
    message = SegmentMessage("/c", 5, 6, digest("x"), 1, SegmentPlace("r/1.mcap", 9))
    entry = index_document("r", message, "n/c", distinct=False)
    assert (entry["_id"], entry["stored"], entry["size"]) == ("r//c/5", None, 1)
    assert index_document("r", message, "n/c", distinct=True)["_id"] != entry["_id"]


def test_duplicates_are_bounded_and_exact() -> None:
    seen = Duplicates(stamps_max=2)
    assert seen.admit("/p", 1, digest("a"))
    assert not seen.admit("/p", 1, digest("a"))
    assert seen.admit("/p", 1, digest("b"))
    assert seen.admit("/q", 1, digest("a"))
    assert seen.shares_stamp("/p", 1)
    assert not seen.shares_stamp("/q", 1)
    assert seen.admit("/p", 2, digest("a"))
    assert seen.admit("/p", 3, digest("a"))
    assert seen.admit("/p", 1, digest("a")), "forgotten: two stamps later"
    assert seen.dropped == 1


def test_a_ledger_without_its_end_is_refused() -> None:
    import pytest

    from robotkube.errors import DocumentError

    text = '{"sequence": 0, "stamp": 5, "sha256": "ab"}'
    assert read_ledger([text, '{"end": true, "count": 1}'], "x") == [LedgerLine(0, 5, "ab")]
    for lines, problem in [
        ([text], "has no end line"),
        ([text, '{"end": true, "count": 2}'], "has 1 messages, says 2"),
        ([text[:20]], "line 1: is no ledger line"),
        ([text, "[" * 100_000], "line 2: is no ledger line .nested deeper than 100 levels"),
    ]:
        with pytest.raises(DocumentError, match=problem):
            read_ledger(lines, "x")


@given(st.binary(max_size=40), st.integers(0, 5))
def test_padding_of_the_middleware_is_no_other_message(data: bytes, zeros: int) -> None:
    """Fast DDS gives a message of 10 bytes as one of 12, the last two zero."""
    padded = data + bytes(zeros)
    own, received = hashlib.sha256(data).hexdigest(), hashlib.sha256(padded).hexdigest()
    fills = 0 < zeros <= 3 and len(padded) % 4 == 0
    assert published_digest(padded, received, {own}) == (own if fills or not zeros else "")
    assert published_digest(padded, received, {own, received}) == received
    assert published_digest(padded, received, ()) == ""


def test_a_padded_message_is_compared_without_its_padding() -> None:
    message = replace(stored(150, "padded"), published_sha256=line(150).sha256)
    assert compare_topic("/p", [line(150)], [message], WINDOW).complete
    assert compare_topic("/p", [line(150)], [replace(message, published_sha256="")], WINDOW).mismatches == (150,)


MS = 1_000_000
PERIOD = 100 * MS


def unstamped(due: int, latency: int, text: str) -> StoredMessage:
    """A message without a header: its stamp is when it was received."""
    value = digest(text)
    return StoredMessage("/text", due + latency, value, value, 10, received=due + latency)


@given(
    st.lists(st.tuples(st.booleans(), st.integers(0, 250), st.sampled_from("abc")), min_size=1, max_size=30),
    st.booleans(),
)
def test_messages_without_a_header_are_paired_by_what_they_say(
    published: list[tuple[bool, int, str]], told: bool
) -> None:
    """Some are lost, some late; reception is later than what a ledger has, and no correct recording is accused."""
    ledger = [LedgerLine(n, n * PERIOD, digest(text)) for n, (_, _, text) in enumerate(published)]
    arrived = [(n, ms, text) for n, (lost, ms, text) in enumerate(published) if not lost]
    messages = [unstamped(n * PERIOD, ms * MS + 1 + n, text) for n, ms, text in arrived]
    lost = len(ledger) - len(messages)
    gap = {"where": "queue", "why": "full", "count": lost, "first": 5, "last": 6}
    audit = {
        "topic": "/text", "received": len(ledger), "stored": len(messages), "early": 0, "duplicates": 0,
        "dropped": lost if told else 0, "gaps": [gap] if told and lost else [], "closed": True,
    }  # fmt: skip
    (topic,) = examine(messages, add_up([audit]), {"/text": ledger}, (0, 10**12))
    assert topic.comparison is not None
    assert (topic.comparison.unknown, topic.comparison.mismatches) == ((), ())
    assert len(topic.comparison.lost) == lost
    if messages:
        assert topic.unexplained == (0 if told else lost)
        assert topic.complete == (lost == 0)


def test_a_message_without_a_header_that_nobody_published_is_unknown() -> None:
    ledger = [LedgerLine(0, PERIOD, digest("a"))]
    for strange in (
        unstamped(PERIOD, 5, "b"), unstamped(-LATENCY_NS_MAX, 0, "a"), unstamped(PERIOD, LATENCY_NS_MAX + 1, "a"),
    ):  # fmt: skip
        comparison = compare_topic("/text", ledger, [strange], (-(10**12), 10**12))
        assert (comparison.unknown, len(comparison.lost)) == ((strange.stamp,), 1)


def test_a_latched_message_without_a_header_may_come_again() -> None:
    ledger = [LedgerLine(0, PERIOD, digest("a"))]
    again = [unstamped(PERIOD, ms * MS, "a") for ms in (5, 50_000, 90_000)]
    assert compare_topic("/text", ledger, again, (0, 10**12), latched=True).complete
    assert len(compare_topic("/text", ledger, again, (0, 10**12)).unknown) == 2
