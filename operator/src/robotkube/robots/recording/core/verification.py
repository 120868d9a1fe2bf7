"""The verification of a recording: it holds what its audits say, and what its sources' ledgers say, if any. Pure.

Three witnesses are compared: the stored bytes with the digests written beside them, the number of stored messages with
the audits, and the stored stamps with the ledgers. A message that is missing is explained when a gap of its topic
covers its stamp.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from robotkube.robots.recording.core.audits import AuditSum
from robotkube.robots.recording.core.ledgers import (
    CLOCK_NS_MAX,
    LATENCY_NS_MAX,
    LedgerLine,
    StoredMessage,
    TopicComparison,
    compare_topic,
)
from robotkube.robots.ros.core.topic_patterns import TopicPattern

Window = tuple[int, int]


@dataclass(frozen=True)
class TopicExamination:
    """The examination of one topic. `audit` is None when there is none, `comparison` when there is no ledger; `stored`
    counts different messages, `duplicates` further copies; `mismatches` are stamps whose bytes are not those that were
    stored."""

    topic: str
    stored: int
    duplicates: int
    mismatches: tuple[int, ...]
    unreadable: tuple[str, ...]
    audit: AuditSum | None = None
    comparison: TopicComparison | None = None

    @property
    def unexplained(self) -> int:
        """Messages that are missing although no gap says so: by the audit's numbers, or by the ledger's stamps."""
        lost = self.comparison.lost if self.comparison else ()
        loose = self.comparison is not None and self.comparison.unstamped
        by_ledger = self._unexplained_unstamped(lost) if loose else self._uncovered(lost, 0, 0)
        return max(by_ledger, self.audit.unexplained(self.stored) if self.audit else 0)

    def _unexplained_unstamped(self, lost: Sequence[LedgerLine]) -> int:
        """Lost lines of a topic whose gaps are between times of reception: those are later than the lines, and only
        their numbers agree."""
        known = sum(gap.count or 0 for gap in self.audit.gaps) if self.audit else 0
        return max(0, self._uncovered(lost, CLOCK_NS_MAX, LATENCY_NS_MAX) - known)

    def _uncovered(self, lost: Sequence[LedgerLine], earlier: int, later: int) -> int:
        """How many lines no gap covers, when a message is received up to `earlier` before and `later` after it is due;
        with either, of gaps of an unknown number alone."""
        gaps = self.audit.gaps if self.audit else ()
        chosen = [gap for gap in gaps if gap.count is None or not later]
        return sum(not any(gap.first - later <= line.stamp <= gap.last + earlier for gap in chosen) for line in lost)

    @property
    def missing(self) -> int:
        """Messages that the gaps say are not there: dropped on the way or here, or missing in what was received."""
        return sum(gap.count or 0 for gap in self.audit.gaps) if self.audit else 0

    @property
    def problems(self) -> list[str]:
        """The problems in words; empty when there are none."""
        gaps = self.audit.gaps if self.audit else ()
        comparison = self.comparison
        counts = [
            (len(self.mismatches), "with other bytes than were stored"),
            (self.duplicates, "stored twice"),
            (len(self.unreadable), "unreadable"),
            (len(gaps), "gaps"),
            (self.unexplained, "missing without explanation"),
            (len(comparison.lost) if comparison else 0, "of the ledger not stored"),
            (len(comparison.mismatches) if comparison else 0, "with other bytes than the ledger says"),
            (len(comparison.unknown) if comparison else 0, "that no ledger has"),
        ]
        unaudited = ["no audit says what was received"] if self.stored and self.audit is None else []
        return [f"{count} {text}" for count, text in counts if count] + unaudited

    @property
    def counted(self) -> bool:
        """Return whether the audits' numbers are those of all writers: of one that was killed, or is at work, they are
        as it wrote them last, and what it received after that is in none."""
        audit = self.audit
        return audit is not None and not audit.interrupted and audit.accounted >= self.stored

    @property
    def silent(self) -> bool:
        """Return whether there is no message and no ledger says why: perhaps there was nothing to record."""
        received = self.audit.received if self.audit else 0
        return not (self.problems or self.stored or received or self.comparison)

    @property
    def complete(self) -> bool | None:
        """Return whether everything that was there to record is stored as it was; None when nobody knows, for want of
        any message."""
        return None if self.silent else not self.problems


def examine(
    stored: Iterable[StoredMessage],
    audits: Mapping[str, AuditSum],
    ledgers: Mapping[str, Sequence[LedgerLine]],
    window: Window,
    latched: Collection[str] = (),
    listed: Collection[str] = (),
) -> list[TopicExamination]:
    """Examine every topic that is stored, audited or in a ledger, and those `listed`, names or patterns, that none of
    them fits. Ledgers are compared within `window`, both ends included. `latched`: topics of which every new
    subscription gets the last message again."""
    by_topic: dict[str, list[StoredMessage]] = {topic: [] for topic in (*audits, *ledgers)}
    for message in stored:
        by_topic.setdefault(message.topic, []).append(message)
    by_topic |= {name: [] for name in without_any(listed, by_topic)}
    return [
        _examine(topic, messages, audits.get(topic), ledgers.get(topic), window, topic in latched)
        for topic, messages in sorted(by_topic.items())
    ]


def without_any(listed: Iterable[str], topics: Collection[str]) -> list[str]:
    """The `listed` names and patterns that none of the topics fits."""
    patterns = [TopicPattern(text) for text in listed]
    return [pattern.text for pattern in patterns if all(pattern.agent(topic) is None for topic in topics)]


def _examine(
    topic: str,
    messages: Sequence[StoredMessage],
    audit: AuditSum | None,
    ledger: Sequence[LedgerLine] | None,
    window: Window,
    latched: bool,
) -> TopicExamination:
    copies = Counter((message.stamp, message.recorded_sha256) for message in messages)
    return TopicExamination(
        topic=topic,
        stored=len(copies),
        duplicates=len(messages) - len(copies),
        mismatches=tuple(m.stamp for m in messages if not m.problem and m.sha256 != m.recorded_sha256),
        unreadable=tuple(m.problem for m in messages if m.problem),
        audit=audit,
        comparison=None if ledger is None else compare_topic(topic, ledger, messages, window, latched),
    )
