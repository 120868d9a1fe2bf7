"""The audit of a recording: per topic what was received, stored and dropped, where, why and from which stamp to which.

Pure. Every writer of a recording (a detector from its start to its end) keeps audits of its own, so nobody has to
know what an earlier one wrote; a reader adds them up. Stamps are integers in ns since 1970.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from robotkube.robots.ros.core.gaps import Gap, Interval, read_gap

GAPS_MAX = 1000
STAMPS_KEPT_MAX = 100_000
REGULAR_STAMPS_MIN = 10
REGULAR_SHARE_MIN = 0.9
REGULAR_TOLERANCE = 0.2
HOLE_PERIODS = 1.5

QUEUE = "queue"
VOLUME = "volume"
SPOOL = "spool"
MEMORY = "memory"
RECORDER = "recorder"
SOURCE = "source"
BUFFER = "buffer"
SUBSCRIPTION = "subscription"
KILLED = "killed"
MISSING = "missing in what was received"
OVERFLOW = "full"
EVICTED = "left the buffer before"
PUSHED_OUT = "pushed out before it was taken"


@dataclass
class TopicAudit:
    """What one writer did with the messages of one topic.

    `received = stored + early + duplicates + dropped + waiting`; `stored` counts what was added to the journal, which
    keeps order: once the database has this audit it has these messages, too, or the journal's own audit says why not.
    `gaps`: what was received and given up; `never_received`: what did not arrive, as somebody knows. `changed`: there
    is a gap that is not written yet. `unsettled`: of a topic whose messages take two paths, large and small ones, the
    first stamp that may not have been added yet; None where all take one path, in order.
    """

    topic: str
    received: int = 0
    stored: int = 0
    early: int = 0
    duplicates: int = 0
    first: int | None = None
    last: int | None = None
    gaps: list[Gap] = field(default_factory=list)
    never_received: list[Gap] = field(default_factory=list)
    changed: bool = False
    unsettled: int | None = None
    _spaces: list[_Space] = field(default_factory=list)
    _joinable: bool = False
    _stamps: array[int] = field(default_factory=lambda: array("q"))

    @property
    def dropped(self) -> int:
        """Messages that were received and are not in storage."""
        return sum(gap.count or 0 for gap in self.gaps)

    @property
    def waiting(self) -> int:
        """Messages that were received and are not settled yet."""
        return self.received - self.stored - self.early - self.duplicates - self.dropped

    def receive(self, stamp: int) -> None:
        """Count a received message of this stamp."""
        self.received += 1
        self.first = stamp if self.first is None or stamp < self.first else self.first
        self.last = stamp if self.last is None or stamp > self.last else self.last
        self._stamps.append(stamp)
        if len(self._stamps) > STAMPS_KEPT_MAX:
            self._settle_older()

    def mark_unsettled(self, stamp: int, due: bool) -> None:
        """Note that messages from this stamp on may not be in the journal yet. A later stamp than before is written
        only with everything else (`due`)."""
        if due or self.unsettled is None or stamp < self.unsettled:
            self.unsettled = stamp
            self.changed = True

    def count_early(self) -> None:
        """Count a received message that came before the begin."""
        self.early += 1

    def count_duplicate(self) -> None:
        """Count a received message that is stored already."""
        self.duplicates += 1

    def store(self, count: int) -> None:
        """Count messages that were added to the journal."""
        self.stored += count
        self._joinable = False

    def drop(self, where: str, why: str, stamp: int) -> None:
        """Give up a received message. Neighbours of one reason are one gap; beyond GAPS_MAX all are."""
        last = self.gaps[-1] if self.gaps else None
        full = len(self.gaps) >= GAPS_MAX
        gap = Gap(self.topic, where, why, 1, stamp, stamp)
        if last is None or not (full or (self._joinable and (last.where, last.why) == (where, why))):
            self.gaps.append(gap)
        else:
            self.gaps[-1] = _joined(last, gap)
        self._joinable = self.changed = True

    def note_gap(self, gap: Gap) -> None:
        """Note a gap of messages that were never received here. Beyond GAPS_MAX all are one."""
        if len(self.never_received) >= GAPS_MAX:
            self.never_received[-1] = _joined(self.never_received[-1], gap)
        else:
            self.never_received.append(gap)
        self.changed = True

    def document(self, holes_within: Sequence[Interval] | None = None) -> dict[str, Any]:
        """The audit as it is stored; with `holes_within` also what is missing in the received stamps of each of these
        intervals and nobody has reported."""
        spaces = list(self._spaces)
        if holes_within is not None:
            spaces += _spaces_of(self._stamps, holes_within)
        gaps = self.gaps + self.never_received + self._unreported(spaces)
        return {
            "topic": self.topic,
            "window": None if self.first is None else [self.first, self.last],
            "received": self.received,
            "stored": self.stored,
            "early": self.early,
            "duplicates": self.duplicates,
            "dropped": self.dropped,
            "unsettled": self.unsettled,
            "gaps": [gap.document() for gap in sorted(gaps, key=lambda gap: (gap.first, gap.last))],
        }

    def _settle_older(self) -> None:
        """Look for holes in the older half of the stamps and forget it."""
        stamps = sorted(self._stamps)
        middle = len(stamps) // 2
        self._spaces += _spaces(stamps[: middle + 1])
        self._stamps = array("q", stamps[middle:])

    def _unreported(self, spaces: Iterable[_Space]) -> list[Gap]:
        """A gap for each space in which more is missing than somebody has reported."""
        left = [gap.count or 0 for gap in self.never_received]
        gaps = []
        for space in spaces:
            count = space.count
            for number, gap in enumerate(self.never_received):
                if gap.first < space.later and gap.last > space.earlier:
                    reported = min(count, left[number])
                    count -= reported
                    left[number] -= reported
            if count:
                gaps.append(Gap(self.topic, SOURCE, MISSING, count, space.first, space.last))
        return gaps


@dataclass(frozen=True, slots=True)
class _Space:
    """Two stamps of a regular topic, one after the other, between which there should be more."""

    earlier: int
    later: int
    period: int

    @property
    def count(self) -> int:
        """The number of missing messages; exact for an even period."""
        return round((self.later - self.earlier) / self.period) - 1

    @property
    def first(self) -> int:
        """The stamp from which on one is missing, as early as the distances of a regular topic vary."""
        return min(self.earlier + self._distance_min, self.later - 1)

    @property
    def last(self) -> int:
        """The stamp until which one is missing, as late as they vary."""
        return max(self.later - self._distance_min, self.first)

    @property
    def _distance_min(self) -> int:
        return max(1, int(self.period * (1 - REGULAR_TOLERANCE)))


def _joined(gap: Gap, other: Gap) -> Gap:
    """Two gaps as one, for the first one's reason."""
    count = None if gap.count is None or other.count is None else gap.count + other.count
    return Gap(gap.topic, gap.where, gap.why, count, min(gap.first, other.first), max(gap.last, other.last))


def _spaces_of(stamps: Iterable[int], intervals: Sequence[Interval]) -> Iterable[_Space]:
    for first, last in intervals:
        yield from _spaces([stamp for stamp in stamps if first <= stamp <= last])


def holes(stamps: Iterable[int]) -> list[tuple[int, int, int]]:
    """The holes in the stamps of a regular topic: between which stamps, and how many are missing.

    Regular: nine of ten distances lie within a fifth of the median. Of other topics nobody can say that something is
    missing: they have no holes. An even period gives the exact number.
    """
    return [(space.first, space.last, space.count) for space in _spaces(stamps)]


def _spaces(stamps: Iterable[int]) -> list[_Space]:
    ordered = sorted(set(stamps))
    distances = [later - earlier for earlier, later in pairwise(ordered)]
    if len(ordered) < REGULAR_STAMPS_MIN:
        return []
    period = sorted(distances)[len(distances) // 2]
    regular = sum(abs(distance - period) <= REGULAR_TOLERANCE * period for distance in distances)
    if regular < REGULAR_SHARE_MIN * len(distances):
        return []
    return [
        _Space(earlier, later, period)
        for earlier, later in pairwise(ordered)
        if later - earlier >= HOLE_PERIODS * period
    ]


@dataclass(frozen=True)
class Interruption:
    """The loss of a killed writer: from the stamp `since` on, messages of the topic may be lost. `until`: the first
    stamp that a later writer received; None when there was none yet."""

    topic: str
    since: int
    until: int | None


def interruptions(
    audits: Sequence[Mapping[str, Any]], stamps: Mapping[str, Sequence[int]], own_life: int | None = None
) -> list[Interruption]:
    """The losses of a recording's killed writers, by their audits that are not closed, or that they did not even
    begin. `stamps`: what is stored. Audits of `own_life` are those of the calling writer: they only say where the
    others end.

    A writer stores in the order of its stamps, and says what it drops in its next audit: what it lost without a word
    comes after the last stamp that is stored, as far as its last audit had seen any. What is stored beyond that may be
    of a later writer who was killed before its first audit, and says nothing of this one. Where messages take two
    paths, one may be ahead of the other: what is lost comes after what the last audit knew to be settled."""
    losses: list[Interruption] = []
    later: dict[str, int] = {}
    for audit in sorted(audits, key=lambda audit: int(audit["life"]), reverse=True):
        topic = audit["topic"]
        window = audit["window"]
        until = later.get(topic)
        since = audit.get("unsettled")
        if since is None:
            since = _first_uncertain(_before(until, stamps.get(topic, ())), window)
        if not audit["closed"] and audit["life"] != own_life and since is not None:
            losses.append(Interruption(topic, since, until))
        if window:
            later[topic] = min(window[0], until) if until is not None else window[0]
    audited = {audit["topic"] for audit in audits if audit["life"] != own_life}
    unaudited = {topic: _before(later.get(topic), known) for topic, known in stamps.items() if topic not in audited}
    return losses + [Interruption(name, max(known) + 1, later.get(name)) for name, known in unaudited.items() if known]


def _before(until: int | None, stamps: Sequence[int]) -> Sequence[int]:
    return stamps if until is None else [stamp for stamp in stamps if stamp < until]


def _first_uncertain(stored: Sequence[int], window: Sequence[int] | None) -> int | None:
    """The first stamp that may be lost; None when the writer has neither received nor stored anything."""
    if window is None:
        return max(stored) + 1 if stored else None
    first, last = window
    return max((stamp + 1 for stamp in stored if first <= stamp <= last), default=first)


@dataclass(frozen=True)
class AuditSum:
    """All audits of one topic of a recording together. `open`: a writer has not ended its own; `exact`: nothing that
    cannot be counted happened."""

    topic: str
    received: int = 0
    stored: int = 0
    early: int = 0
    duplicates: int = 0
    dropped: int = 0
    gaps: tuple[Gap, ...] = ()
    open: bool = False

    @property
    def exact(self) -> bool:
        """Return whether every number is known."""
        return not self.open and all(gap.count is not None for gap in self.gaps)

    @property
    def interrupted(self) -> bool:
        """Return whether a writer is at work, or was killed: what it received after its last audit is in no number."""
        return self.open or any((gap.where, gap.why) == (RECORDER, KILLED) for gap in self.gaps)

    @property
    def accounted(self) -> int:
        """The number of messages that should be in storage."""
        return self.received - self.early - self.duplicates - self.dropped

    def unexplained(self, present: int) -> int:
        """Received messages that are neither among the `present` ones in storage nor accounted for."""
        return self.accounted - present if self.exact else 0


def add_up(documents: Iterable[Mapping[str, Any]]) -> dict[str, AuditSum]:
    """Topic -> sum of its audits."""
    sums: dict[str, AuditSum] = {}
    for document in documents:
        topic = document["topic"]
        known = sums.get(topic, AuditSum(topic))
        numbers = {
            name: getattr(known, name) + document[name]
            for name in ("received", "stored", "early", "duplicates", "dropped")
        }
        gaps = tuple(read_gap(topic, values) for values in document["gaps"])
        both = tuple(dict.fromkeys(known.gaps + gaps))  # bridges report their gaps to each writer
        sums[topic] = AuditSum(topic=topic, gaps=both, open=known.open or not document["closed"], **numbers)
    return sums
