"""The journal of deliveries that wait, on the disk: a process that is killed loses no edge, its successor goes on.

A thread of its own writes; who adds an edge never waits for the disk, and its delivery begins at once. What is
delivered before that thread has come to it is never written. Additions are synced together, and are safe against a
kill once written and against a loss of power once synced; removals are not synced: at worst an edge is delivered
twice, with the same id. While the disk refuses, everything goes on in memory, and `/status` counts it and says why.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.ports.deliveries import DeliveryLog, EdgeDelivery, JournalEntry

JOURNAL_BYTES_MAX, LOG_BYTES_MAX = 8 * 1024 * 1024, 16 * 1024 * 1024
"""Of what waits, and of the log with what is gone already; beyond the second the log is written anew."""
ENTRY_BYTES = 300  # beside the body
OPEN_SECONDS_MAX = 5.0
"""The longest time for which reactions wait for what a predecessor has left."""
UNCLAIMED_SECONDS = 60.0
ENTRY_SECONDS_MAX = 86_400
WAIT_SECONDS = 1.0
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 0.5, 30.0
MEMORY_ONLY: Mapping[str, Any] = {
    "problem": "ROBOTKUBE_REACTIONS names no folder: what waits is in memory only",
    "kept": 0,
    "unkept": 0,
    "replayed": 0,
    "bytes": 0,
}

_Key = tuple[str, str]

log = logging.getLogger(__name__)


class DeliveryJournal:
    """The journal of a detector's deliveries. `start`; a `ReactionJournal` for each reaction; `end` when the process is
    to end, `stop` when reactions have ended."""

    def __init__(
        self,
        delivery_log: DeliveryLog,
        box: DeadLetterBox,
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
        jitter: Random = random.random,
    ) -> None:
        self._delivery_log = delivery_log
        self._box = box
        self._clock_ns = clock_ns
        self._monotonic = monotonic
        self._jitter = jitter
        self._lock = threading.Lock()
        self._entries: dict[_Key, JournalEntry] = {}
        self._unwritten: dict[_Key, JournalEntry] = {}
        self._writing: dict[_Key, JournalEntry] = {}
        self._removed: set[_Key] = set()
        self._counted_unkept: set[_Key] = set()
        self._from_predecessor: dict[str, list[JournalEntry]] = {}
        self._bytes = self.unkept = self.replayed = 0
        self._begun = monotonic()
        self._opened = self._ending = False
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self.settled = threading.Event()
        self.problem = "not read yet"
        self._thread = threading.Thread(target=self._run, name="delivery-journal", daemon=True)

    def start(self) -> None:
        """Read what is left, and begin to write, on a thread of its own."""
        self._thread.start()

    def add(self, reaction: str, name: str, delivery: EdgeDelivery) -> None:
        """Add a delivery; never blocks."""
        entry = JournalEntry(reaction, name, self._clock_ns(), delivery)
        key = _key(entry)
        size = _size(entry)
        with self._lock:
            if key in self._entries:
                return
            if self._bytes + size > JOURNAL_BYTES_MAX:
                self.unkept += 1
                return
            self._entries[key] = self._unwritten[key] = entry
            self._bytes += size
        self._wake.set()

    def done(self, reaction: str, identity: str) -> None:
        """Remove a delivery that is delivered or given up; never blocks."""
        key = reaction, identity
        with self._lock:
            entry = self._entries.pop(key, None)
            if entry is None:
                return
            self._bytes -= _size(entry)
            self._counted_unkept.discard(key)
            if self._unwritten.pop(key, None) is None or key in self._removed:
                self._removed.add(key)
        self._wake.set()

    def from_predecessor(self, reaction: str) -> Sequence[EdgeDelivery]:
        """The deliveries that a predecessor has left of a reaction, in their order; each is given once."""
        if not self._from_predecessor:
            return ()
        with self._lock:
            entries = self._from_predecessor.pop(reaction, [])
        self.replayed += len(entries)
        return [entry.delivery for entry in entries]

    def end(self) -> None:
        """Leave what is on the disk to the next process from now on."""
        self._ending = True

    def outlives(self, reaction: str, identity: str) -> bool:
        """Return whether this process is to end, and the next one will find the delivery."""
        key = reaction, identity
        with self._lock:
            written = key in self._entries and key not in self._unwritten and key not in self._writing
        return self._ending and written

    def stop(self, seconds: float) -> bool:
        """Write what is to be written, within `seconds`; True when it was."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(seconds)
        return not (self._thread.is_alive() or self._unwritten or self._removed)

    def document(self) -> dict[str, Any]:
        """The counts as the status has them. `kept`: on the disk now; `unkept`: were in memory only, at least for a
        while; `replayed`: taken over."""
        with self._lock:
            kept = len(self._entries.keys() - self._unwritten.keys() - self._writing.keys())
        numbers = {"kept": kept, "unkept": self.unkept, "replayed": self.replayed, "bytes": self._delivery_log.size}
        return {"problem": self.problem, **numbers}

    # the journal's own thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        failures = 0
        try:
            while True:
                over = self._stopping.is_set()
                if self.turn():
                    failures = 0
                else:
                    self._stopping.wait(backoff(failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter))
                    failures += 1
                if over:
                    return
                self._wake.wait(WAIT_SECONDS)
                self._wake.clear()
        finally:
            self._delivery_log.close()

    def turn(self) -> bool:
        """Do what can be done now; False when the disk refused."""
        try:
            if not self._opened:
                self._resume(self._delivery_log.open())
                self._opened = True
            self._write()
        except OSError as error:
            self._note_refusal(str(error))
            return False
        finally:
            self.settled.set()
        self.problem = ""
        if self._from_predecessor and self._monotonic() - self._begun > UNCLAIMED_SECONDS:
            self._give_up_unclaimed()
        return True

    def _resume(self, entries: Sequence[JournalEntry]) -> None:
        """Go on with the deliveries of an earlier process; what has waited for too long is given up."""
        oldest = self._clock_ns() - ENTRY_SECONDS_MAX * 1_000_000_000
        with self._lock:
            for entry in entries:
                if _key(entry) not in self._entries:
                    self._entries[_key(entry)] = entry
                    self._bytes += _size(entry)
                    if entry.time >= oldest:
                        self._from_predecessor.setdefault(entry.reaction, []).append(entry)
        if entries:
            log.info("reactions: %d deliveries of an earlier process are resumed", len(entries))
        for entry in entries:
            if entry.time < oldest:
                self._give_up(entry, f"it has waited for more than {ENTRY_SECONDS_MAX} s")

    def _write(self) -> None:
        with self._lock:
            added = dict(self._unwritten)
            removed = set(self._removed)
            entries = dict(self._entries)
            self._writing = added
            self._unwritten.clear()
            self._removed.clear()
        try:
            if not entries or self._delivery_log.size > LOG_BYTES_MAX:
                if self._delivery_log.size:
                    self._delivery_log.replace(list(entries.values()))
            elif added or removed:
                self._delivery_log.write(list(added.values()), sorted(removed))
        except OSError:
            self._restore(added, removed)
            raise
        with self._lock:
            self._writing = {}

    def _restore(self, added: Mapping[_Key, JournalEntry], removed: set[_Key]) -> None:
        """Queue again what the disk has refused: nobody knows what it has of it."""
        with self._lock:
            self._writing = {}
            self._removed |= removed
            self._unwritten = {key: entry for key, entry in added.items() if key in self._entries} | self._unwritten
            self.unkept += len(self._unwritten.keys() - self._counted_unkept)
            self._counted_unkept |= self._unwritten.keys()

    def _note_refusal(self, text: str) -> None:
        if text != self.problem:
            log.warning("reactions: what waits is in memory only: %s; trying again", text)
        self.problem = text

    def _give_up_unclaimed(self) -> None:
        with self._lock:
            unclaimed = [entry for entries in self._from_predecessor.values() for entry in entries]
            self._from_predecessor = {}
        for entry in unclaimed:
            self._give_up(entry, "the settings do not ask for this reaction any more")

    def _give_up(self, entry: JournalEntry, reason: str) -> None:
        self._box.add(entry.name, entry.delivery.id, reason)
        self.done(*_key(entry))


class ReactionJournal:
    """The journal as one reaction sees it. `reaction`: its key; without a journal everything is in memory only."""

    def __init__(self, journal: DeliveryJournal | None = None, reaction: str = "", name: str = "") -> None:
        self._journal = journal
        self._reaction = reaction
        self._name = name

    def add(self, delivery: EdgeDelivery) -> None:
        """Add a delivery; never blocks."""
        if self._journal is not None:
            self._journal.add(self._reaction, self._name, delivery)

    def done(self, delivery: EdgeDelivery) -> None:
        """Remove a delivery that is delivered or given up."""
        if self._journal is not None:
            self._journal.done(self._reaction, delivery.id)

    @property
    def settled(self) -> bool:
        """Return whether it is known what a predecessor has left, or that nobody can know."""
        return self._journal is None or self._journal.settled.is_set()

    def wait(self, seconds: float) -> None:
        """Wait until it is settled, at most so long."""
        if self._journal is not None:
            self._journal.settled.wait(seconds)

    def from_predecessor(self) -> Sequence[EdgeDelivery]:
        """The deliveries that a predecessor has left; each is given once."""
        return () if self._journal is None else self._journal.from_predecessor(self._reaction)

    def outlives(self, delivery: EdgeDelivery) -> bool:
        """Return whether the process is to end, and the next one will find the delivery."""
        return self._journal is not None and self._journal.outlives(self._reaction, delivery.id)


def _key(entry: JournalEntry) -> _Key:
    return entry.reaction, entry.delivery.id


def _size(entry: JournalEntry) -> int:
    return ENTRY_BYTES + len(entry.delivery.body)
