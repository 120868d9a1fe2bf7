"""The comparison of a topic's storage with its source's ledger. Pure. Stamps and times are integers in ns since 1970.

Two things on the way are no faults. The middleware fills a message up to a multiple of four bytes with zeros, so a
message may end with up to three that nobody published. And a message without a header is stored with the time of its
reception as its stamp, where the ledger has the moment at which it was due: those are paired by what they say.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

PADDING_BYTES_MAX = 3
ALIGNMENT = 4
LATENCY_NS_MAX = 10 * 1_000_000_000
"""A message without a header is received at most so long after it was due."""
CLOCK_NS_MAX = 1_000_000_000
"""The clocks of source and recorder differ by no more."""


@dataclass(frozen=True)
class LedgerLine:
    """One published message, as its source wrote it down."""

    sequence: int
    stamp: int
    sha256: str


@dataclass(frozen=True)
class StoredMessage:
    """One message in storage: `sha256` computed from the stored bytes now, `recorded_sha256` the digest written beside
    it.

    `sha256` is empty when the bytes could not be read; `problem` says why. `received`: when, ns. `published_sha256`:
    the digest that a ledger has for these bytes without padding; empty when it has none.
    """

    topic: str
    stamp: int
    sha256: str
    recorded_sha256: str
    size: int
    problem: str = ""
    received: int | None = None
    published_sha256: str = ""

    @property
    def unstamped(self) -> bool:
        """Return whether its stamp is the time of its reception: it has none of its own."""
        return self.stamp == self.received


def published_digest(data: bytes, sha256: str, published: Collection[str]) -> str:
    """The digest among the `published` ones that is of `data`, whose own is `sha256`, with or without padding."""
    if sha256 in published or not published or not data or len(data) % ALIGNMENT:
        return sha256 if sha256 in published else ""
    for count in range(1, PADDING_BYTES_MAX + 1):
        if data[-count] != 0:
            break
        digest = hashlib.sha256(data[:-count]).hexdigest()
        if digest in published:
            return digest
    return ""


@dataclass(frozen=True)
class TopicComparison:
    """The comparison of a topic's storage and ledger within a window of stamps (both ends included).

    `published`, `stored`: numbers of ledger lines and of stored messages in the window. `lost`: ledger lines that are
    not in storage. `duplicates`: stored copies beyond the first. `mismatches`: stored messages whose bytes differ from
    the ledger's or from the digest written when they were stored. `unknown`: stored stamps that no ledger line has.
    `unreadable`: stored messages whose bytes are not there. `unstamped`: messages were paired by what they say.
    """

    topic: str
    published: int
    stored: int
    lost: tuple[LedgerLine, ...]
    duplicates: tuple[int, ...]
    mismatches: tuple[int, ...]
    unknown: tuple[int, ...]
    unreadable: tuple[str, ...]
    unstamped: bool = False

    @property
    def complete(self) -> bool:
        """Return whether nothing is lost, doubled, changed, invented or unreadable."""
        return not (self.lost or self.duplicates or self.mismatches or self.unknown or self.unreadable)


@dataclass(frozen=True)
class LedgerComparison:
    """The comparison of a recording with its sources' ledgers; `window` are the stamps it covers.

    `without_ledger`: stored topics that nothing was compared with.
    """

    recording: str
    window: tuple[int, int]
    topics: Mapping[str, TopicComparison] = field(default_factory=dict)
    without_ledger: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Return whether every topic is complete and at least one was compared."""
        return bool(self.topics) and all(topic.complete for topic in self.topics.values())


def compare_topic(
    topic: str,
    ledger: Iterable[LedgerLine],
    stored: Iterable[StoredMessage],
    window: tuple[int, int],
    latched: bool = False,
) -> TopicComparison:
    """Compare one topic. Messages and lines outside the window are left out. Of a `latched` one without headers, a
    message may be there again and again, since every new subscription gets it.

    A ledger line is in storage when a message with its stamp is; equal stamps are told apart by their digests.
    """
    first, last = window
    all_lines = list(ledger)
    all_messages = list(stored)
    paired = _pair(all_lines, all_messages, latched)
    within = [line for line in all_lines if first <= line.stamp <= last]
    lines = [line for line in within if id(line) not in paired]
    inside = [message for message in all_messages if first <= message.stamp <= last]
    messages = [message for message in inside if id(message) not in paired]
    readable = [message for message in messages if not message.problem]
    expected = Counter((line.stamp, line.sha256) for line in lines)
    stamps = {line.stamp for line in lines}
    changed = [m for m in readable if m.stamp in stamps and (m.stamp, m.published_sha256 or m.sha256) not in expected]
    changed += [m for m in inside if not m.problem and m.sha256 != m.recorded_sha256 and m not in changed]
    present = Counter(message.stamp for message in readable)
    published = Counter(line.stamp for line in lines)
    return TopicComparison(
        topic=topic,
        published=len(within),
        stored=len(inside),
        lost=tuple(_lost(lines, present)),
        duplicates=tuple(
            stamp for stamp, count in sorted(present.items()) for _ in range(count - max(1, published[stamp]))
        ),
        mismatches=tuple(sorted(message.stamp for message in changed)),
        unknown=tuple(sorted(message.stamp for message in readable if message.stamp not in stamps)),
        unreadable=tuple(message.problem for message in messages if message.problem),
        unstamped=bool(paired),
    )


def _pair(lines: Sequence[LedgerLine], messages: Sequence[StoredMessage], latched: bool) -> set[int]:
    """The lines, and the messages without a stamp of their own, that are of each other, by `id`.

    Each message is the latest line of its digest that was due before it was received and has none yet."""
    stamps = {line.stamp for line in lines}
    waiting: dict[str, list[LedgerLine]] = {}
    loose = [m for m in messages if m.unstamped and not m.problem and m.stamp not in stamps]
    if not loose:
        return set()
    taken = {message.stamp for message in messages}
    for line in sorted(lines, key=lambda line: line.stamp):
        if line.stamp not in taken:
            waiting.setdefault(line.sha256, []).append(line)
    known = {digest: entries[0].stamp for digest, entries in waiting.items()}
    paired: set[int] = set()
    for message in sorted(loose, key=lambda message: message.stamp):
        digest = message.published_sha256 or message.sha256
        entries = waiting.get(digest, [])
        place = bisect_right(entries, message.stamp + CLOCK_NS_MAX, key=lambda line: line.stamp) - 1
        if place >= 0 and (latched or message.stamp - entries[place].stamp <= LATENCY_NS_MAX):
            paired |= {id(entries.pop(place)), id(message)}
        elif latched and known.get(digest, message.stamp + 1) <= message.stamp:
            paired.add(id(message))
    return paired


def _lost(lines: Sequence[LedgerLine], present: Counter[int]) -> Iterable[LedgerLine]:
    left = Counter(present)
    for line in lines:
        if left[line.stamp] > 0:
            left[line.stamp] -= 1
        else:
            yield line


def compare(
    recording: str,
    ledgers: Mapping[str, Sequence[LedgerLine]],
    stored: Iterable[StoredMessage],
    window: tuple[int, int],
) -> LedgerComparison:
    """Compare a recording with the ledgers of its topics. Stored topics without ledger are named, not compared."""
    by_topic: dict[str, list[StoredMessage]] = {topic: [] for topic in ledgers}
    without: set[str] = set()
    for message in stored:
        if message.topic in by_topic:
            by_topic[message.topic].append(message)
        else:
            without.add(message.topic)
    comparisons = {
        topic: compare_topic(topic, ledgers[topic], messages, window) for topic, messages in sorted(by_topic.items())
    }
    return LedgerComparison(recording, window, comparisons, tuple(sorted(without)))
