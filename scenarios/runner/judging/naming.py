"""Comparison of audits with ledgers: an audit names exactly what is missing in its recording, or not. Pure.

As in `robotkube recording verify` it is asked about stamps that a gap can say something of: from the beginning of the
window to the last cloud that is stored of each vehicle, the earlier of both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scenarios.runner.inputs import AuditGap
from scenarios.runner.judging.encounters import Encounter


@dataclass(frozen=True)
class TopicNaming:
    """What is missing of one topic, by its ledger, and what the audit says of it. `unnamed`: missing, and no gap says
    so; `named_but_present`: a gap says that it is missing, and it is in storage."""

    topic: str
    missing: int
    unnamed: int
    named_but_present: int
    gaps: tuple[AuditGap, ...]

    def row(self) -> Mapping[str, Any]:
        """The topic by the names of the report."""
        gaps = [
            {"where": gap.where, "why": gap.why, "count": gap.count, "first": gap.first, "last": gap.last}
            for gap in self.gaps
        ]
        counts = {"missing": self.missing, "unnamed": self.unnamed, "named_but_present": self.named_but_present}
        return {"topic": self.topic, **counts, "gaps": gaps}


def naming(encounter: Encounter) -> tuple[TopicNaming, ...] | None:
    """What is missing of each of an encounter's four topics; None without a window or a ledger."""
    if encounter.window is None or any(not encounter.ledgers.get(topic) for topic in encounter.topics):
        return None
    begin, end = encounter.window
    end = min([end, *(max(encounter.stamps(topic)) for topic in encounter.cloud_topics)])
    return tuple(_naming(encounter, topic, begin, end) for topic in encounter.topics)


def _naming(encounter: Encounter, topic: str, begin: int, end: int) -> TopicNaming:
    gaps = tuple(gap for gap in encounter.gaps if gap.topic == topic and gap.first <= end and gap.last >= begin)
    stamps = [line.stamp for line in encounter.ledgers[topic] if begin <= line.stamp <= end]
    missing = [stamp for stamp in stamps if stamp not in encounter.stamps(topic)]
    present = [stamp for stamp in stamps if stamp in encounter.stamps(topic)]
    counted = [gap for gap in gaps if gap.count is not None]
    return TopicNaming(topic, len(missing), len(missing) - _covered(missing, gaps), _covered(present, counted), gaps)


def _covered(stamps: Sequence[int], gaps: Sequence[AuditGap]) -> int:
    return sum(any(gap.first <= stamp <= gap.last for gap in gaps) for stamp in stamps)


def unnamed(encounters: Sequence[Encounter]) -> int | None:
    """Messages that are missing although no audit says so."""
    return _total(encounters, lambda topic: topic.unnamed)


def named_but_present(encounters: Sequence[Encounter]) -> int | None:
    """Messages in storage that an audit says are missing."""
    return _total(encounters, lambda topic: topic.named_but_present)


def _total(encounters: Sequence[Encounter], count: Callable[[TopicNaming], int]) -> int | None:
    of_encounters = [naming(encounter) for encounter in encounters]
    if not of_encounters or None in of_encounters:
        return None
    return sum(count(topic) for topics in of_encounters for topic in topics or ())
