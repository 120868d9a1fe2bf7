"""The audits of one recording while it is written: updated by several threads, written to the journal."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from robotkube.robots.recording.core.audits import GAPS_MAX, KILLED, RECORDER, Interruption, TopicAudit, interruptions
from robotkube.robots.recording.core.documents import AUDITS, Write
from robotkube.robots.recording.loops.destinations import RecorderPlace
from robotkube.robots.recording.loops.journal import AUDIT_BYTES, Journal
from robotkube.robots.ros.core.gaps import Gap, Interval

AUDIT_SECONDS = 5.0

Arrival = tuple[str, int]
"""Topic and stamp of a message."""


class RecordingAudits:
    """The audits of one recording, topic by topic. `intervals`: topic -> the stamps to look for holes in, asked when
    the audits are closed."""

    def __init__(
        self,
        recording: str,
        journal: Journal,
        place: RecorderPlace,
        intervals: Callable[[str], Sequence[Interval]],
    ) -> None:
        self.life = place.clock_ns()
        self._recording = recording
        self._journal = journal
        self._place = place
        self._intervals = intervals
        self._lock = threading.Lock()
        self._audits: dict[str, TopicAudit] = {}
        self._written: set[str] = set()
        self._due_at = place.monotonic() + AUDIT_SECONDS
        self._interrupted: dict[str, int] = {}
        self._open_before: dict[str, list[Mapping[str, Any]]] = {}
        self._closed: list[Mapping[str, Any]] = []
        self._killed_since: int | None = None
        self._begun_at: dict[str, int] = {}
        self._paths: tuple[set[str], set[str]] = (set(), set())
        self._reported: dict[str, list[Gap]] = {}
        self._known_before: set[str] = set()

    def __bool__(self) -> bool:
        """Return whether there is an audit to write."""
        return bool(self._audits)

    def documents(self) -> list[dict[str, Any]]:
        """The audit of every topic so far, without holes."""
        with self._lock:
            return [audit.document() for audit in self._audits.values()]

    def receive(self, topic: str, stamp: int, note: Callable[[TopicAudit], None] | None = None) -> None:
        """Count a received message; `note` adds to its audit what became of it at once."""
        with self._lock:
            self._note_gap_before(topic, stamp)
            audit = self._of(topic)
            audit.receive(stamp)
            for gap in self._reported.pop(topic, ()):
                self._note_reported(audit, gap)
            since = self._interrupted.get(topic)
            if since is not None and stamp >= since:
                del self._interrupted[topic]
                self._note_interruption(topic, since, stamp)
            if note is not None:
                note(audit)

    def note_reported_gap(self, gap: Gap) -> None:
        """Note a gap that somebody on the way reports: it counts from the first message of the topic on, which may
        still come. Nothing begins by it."""
        with self._lock:
            audit = self._audits.get(gap.topic)
            if audit is not None and audit.first is not None:
                self._note_reported(audit, gap)
            elif len(reported := self._reported.setdefault(gap.topic, [])) < GAPS_MAX:
                reported.append(gap)

    def note(self, topic: str, note: Callable[[TopicAudit], None]) -> None:
        """Add to a topic's audit what became of a received message."""
        with self._lock:
            note(self._of(topic))

    def store(self, topics: Iterable[str]) -> None:
        """Count one message of each of these topics that was given to the journal."""
        with self._lock:
            for topic in topics:
                self._of(topic).store(1)

    def resume(self, audits: Sequence[Mapping[str, Any]], stamps: Mapping[str, Sequence[int]]) -> None:
        """Resume after earlier writers, of whom these audits and stored stamps are left.

        Some may be of this writer itself, when the database has them by way of the spool."""
        earlier = [audit for audit in audits if audit["life"] != self.life]
        with self._lock:
            for audit in earlier:
                if not audit["closed"]:
                    self._open_before.setdefault(audit["topic"], []).append(audit)
                if audit["window"]:
                    begun = self._begun_at.get(audit["topic"], audit["window"][0])
                    self._begun_at[audit["topic"]] = min(begun, audit["window"][0])
            killed = interruptions(audits, stamps, self.life)
            for interruption in killed:
                self._interrupt(interruption)
            if killed:
                windows = [audit["window"][0] for audit in earlier if audit["window"]]
                self._killed_since = min([*windows, *(min(known) for known in stamps.values())])
                self._known_before = {audit["topic"] for audit in earlier} | {lost.topic for lost in killed}
                for topic, begun in list(self._audits.items()):
                    if begun.first is not None:
                        self._note_gap_before(topic, begun.first)

    def write_changes(self, small: Iterable[Arrival] = (), large: Iterable[Arrival] = ()) -> bool:
        """Write audits with new gaps at once, all of them now and then; True when there were any.

        `small`, `large`: what is not stored yet and goes to the journal, or to a segment first: that there is a topic,
        what was dropped and what may be overtaken is written before messages are stored. The first audit of a topic is
        durable: without it nobody knew what a kill has cost while the database was unreachable."""
        now = self._place.monotonic()
        due = now >= self._due_at
        self._due_at = now + AUDIT_SECONDS if due else self._due_at
        with self._lock:
            self._note_unsettled(small, large, due)
            new = self._audits.keys() - self._written
            changed = new | {name for name, audit in self._audits.items() if due or audit.changed}
        if changed:
            self._write(changed, durable=bool(new))
        return bool(changed)

    def close(self) -> list[Mapping[str, Any]]:
        """Write the closed audits, with the holes in what was received; all that this writer has closed, an earlier
        one's among them."""
        now = self._place.clock_ns()
        with self._lock:
            for topic, since in self._interrupted.items():
                self._note_interruption(topic, since, max(now, since) + 1)
            for topic in self._open_before:
                self._of(topic)
            self._interrupted.clear()
        self._write(list(self._audits), closed=True)
        return self._closed

    def _of(self, topic: str) -> TopicAudit:
        audit = self._audits.get(topic)
        if audit is None:
            audit = self._audits[topic] = TopicAudit(topic)
        return audit

    def _note_unsettled(self, small: Iterable[Arrival], large: Iterable[Arrival], due: bool) -> None:
        """Note from which stamp on messages of two paths, small and large ones, may overtake each other."""
        first: dict[str, int] = {}
        for topics, arrivals in zip(self._paths, (small, large), strict=True):
            for topic, stamp in arrivals:
                topics.add(topic)
                first[topic] = min(first.get(topic, stamp), stamp)
        for topic in set.intersection(*self._paths):
            audit = self._of(topic)
            audit.mark_unsettled(first.get(topic, (audit.last or 0) + 1), due)

    def _note_reported(self, audit: TopicAudit, gap: Gap) -> None:
        """Note a gap unless it was over before the recording had anything of the topic."""
        firsts = [first for first in (audit.first, self._begun_at.get(gap.topic)) if first is not None]
        if gap.last >= min(firsts):
            audit.note_gap(gap)

    def _interrupt(self, interruption: Interruption) -> None:
        topic = interruption.topic
        audit = self._audits.get(topic)
        first = audit.first if audit is not None else None
        until = interruption.until if interruption.until is not None else first
        if until is None:
            self._interrupted[topic] = interruption.since
        else:
            self._note_interruption(topic, interruption.since, until)

    def _note_gap_before(self, topic: str, first: int) -> None:
        """Note a gap before the `first` stamp of a topic of which a killed writer may have left nothing at all."""
        if self._killed_since is not None and topic not in self._known_before:
            self._known_before.add(topic)
            self._note_interruption(topic, self._killed_since, first)

    def _note_interruption(self, topic: str, since: int, until: int) -> None:
        if until > since:
            self._of(topic).note_gap(Gap(topic, RECORDER, KILLED, None, since, until - 1))

    def _write(self, topics: Iterable[str], closed: bool = False, durable: bool = False) -> None:
        now = self._place.clock_ns()
        writes: list[Write] = []
        with self._lock:
            for topic in sorted(topics):
                audit = self._audits[topic]
                document = {
                    **audit.document(self._intervals(topic) if closed else None),
                    "closed": closed,
                    "written": now,
                }
                audit.changed = False
                name = f"{self._recording}{topic}/{self.life}"
                whole = {"recording": self._recording, "volume": self._place.volume, "life": self.life, **document}
                writes.append(self._audit_write(topic, name, document, whole))
                if closed:
                    self._closed.append({"_id": name, **whole})
                if topic not in self._interrupted:
                    writes += self._close_earlier(topic)
        self._journal.add(writes, durable)

    def _audit_write(self, topic: str, name: str, document: dict[str, Any], whole: dict[str, Any]) -> Write:
        if topic in self._written:
            return Write(AUDITS, name, document, update=True, size=AUDIT_BYTES)
        self._written.add(topic)
        return Write(AUDITS, name, whole, size=AUDIT_BYTES)

    def _close_earlier(self, topic: str) -> list[Write]:
        """Close the audits that killed writers have left open."""
        earlier = self._open_before.pop(topic, [])
        self._closed += earlier
        return [Write(AUDITS, audit["_id"], {"closed": True}, update=True, size=100) for audit in earlier]
