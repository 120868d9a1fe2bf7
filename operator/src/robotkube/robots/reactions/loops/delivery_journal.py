"""What reactions have not delivered yet, on the disk: a process that is killed loses no edge, its successor goes on.

A thread of its own writes; who adds an edge never waits for the disk, and its delivery begins at once. What is
delivered before that thread has come to it is never written. Additions are synced together, and are safe against a
kill once written and against a loss of power once synced; removals are not synced: at worst an edge is told twice,
with the same id. While the disk refuses, everything goes on in memory, is counted and said in `/status`.
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

KEPT_BYTES_MAX, LOG_BYTES_MAX = 8 * 1024 * 1024, 16 * 1024 * 1024
"""Of what waits, and of the log with what is gone already; beyond the second the log is written anew."""
ENTRY_BYTES = 300  # beside the body
OPEN_SECONDS_MAX = 5.0
"""How long reactions wait for what a predecessor has left."""
UNCLAIMED_SECONDS, KEPT_SECONDS_MAX = 60.0, 86_400
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
    """`start`; a `ReactionJournal` for each reaction; `end` when the process is to end, `stop` when reactions have."""

    def __init__(
        self,
        place: DeliveryLog,
        box: DeadLetterBox,
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
        jitter: Random = random.random,
    ) -> None:
        self._place, self._box, self._clock_ns, self._monotonic = place, box, clock_ns, monotonic
        self._jitter = jitter
        self._lock = threading.Lock()
        self._live: dict[_Key, JournalEntry] = {}
        self._unwritten: dict[_Key, JournalEntry] = {}
        self._writing: dict[_Key, JournalEntry] = {}
        self._gone: set[_Key] = set()
        self._doubted: set[_Key] = set()
        self._left: dict[str, list[JournalEntry]] = {}
        self._bytes = self.unkept = self.replayed = 0
        self._begun = monotonic()
        self._opened = self._ending = False
        self._wake, self._stopping, self.settled = threading.Event(), threading.Event(), threading.Event()
        self.problem = "not read yet"
        self._thread = threading.Thread(target=self._run, name="delivery-journal", daemon=True)

    def start(self) -> None:
        """Read what is left, and begin to write, on a thread of its own."""
        self._thread.start()

    def add(self, reaction: str, name: str, delivery: EdgeDelivery) -> None:
        """Keep a delivery; never blocks."""
        entry = JournalEntry(reaction, name, self._clock_ns(), delivery)
        key, size = _key(entry), _size(entry)
        with self._lock:
            if key in self._live:
                return
            if self._bytes + size > KEPT_BYTES_MAX:
                self.unkept += 1
                return
            self._live[key] = self._unwritten[key] = entry
            self._bytes += size
        self._wake.set()

    def done(self, reaction: str, identity: str) -> None:
        """Forget a delivery: it is delivered or given up. Never blocks."""
        key = reaction, identity
        with self._lock:
            entry = self._live.pop(key, None)
            if entry is None:
                return
            self._bytes -= _size(entry)
            self._doubted.discard(key)
            if self._unwritten.pop(key, None) is None or key in self._gone:
                self._gone.add(key)
        self._wake.set()

    def left(self, reaction: str) -> Sequence[EdgeDelivery]:
        """What a predecessor has left of a reaction, in its order; each is given once."""
        if not self._left:
            return ()
        with self._lock:
            found = self._left.pop(reaction, [])
        self.replayed += len(found)
        return [entry.delivery for entry in found]

    def end(self) -> None:
        """From now on what is on the disk is left to the next process."""
        self._ending = True

    def outlives(self, reaction: str, identity: str) -> bool:
        """Whether this process is to end, and the next one will find the delivery."""
        key = reaction, identity
        with self._lock:
            written = key in self._live and key not in self._unwritten and key not in self._writing
        return self._ending and written

    def stop(self, seconds: float) -> bool:
        """Write what is to be written, within `seconds`; whether it was."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(seconds)
        return not (self._thread.is_alive() or self._unwritten or self._gone)

    def document(self) -> dict[str, Any]:
        """`kept`: on the disk now; `unkept`: were in memory only, at least for a while; `replayed`: taken over."""
        with self._lock:
            kept = len(self._live.keys() - self._unwritten.keys() - self._writing.keys())
        numbers = {"kept": kept, "unkept": self.unkept, "replayed": self.replayed, "bytes": self._place.size}
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
            self._place.close()

    def turn(self) -> bool:
        """Do what can be done now; False when the disk refused."""
        try:
            if not self._opened:
                self._take_up(self._place.open())
                self._opened = True
            self._write()
        except OSError as error:
            self._refused(str(error))
            return False
        finally:
            self.settled.set()
        self.problem = ""
        if self._left and self._monotonic() - self._begun > UNCLAIMED_SECONDS:
            self._give_up_unclaimed()
        return True

    def _take_up(self, found: Sequence[JournalEntry]) -> None:
        oldest = self._clock_ns() - KEPT_SECONDS_MAX * 1_000_000_000
        with self._lock:
            for entry in found:
                if _key(entry) not in self._live:
                    self._live[_key(entry)] = entry
                    self._bytes += _size(entry)
                    if entry.time >= oldest:
                        self._left.setdefault(entry.reaction, []).append(entry)
        if found:
            log.info("reactions: %d deliveries of an earlier process are taken up", len(found))
        for entry in found:
            if entry.time < oldest:
                self._give_up(entry, f"it has waited for more than {KEPT_SECONDS_MAX} s")

    def _write(self) -> None:
        with self._lock:
            added, removed, live = dict(self._unwritten), set(self._gone), dict(self._live)
            self._writing = added
            self._unwritten.clear()
            self._gone.clear()
        try:
            if not live or self._place.size > LOG_BYTES_MAX:
                if self._place.size:
                    self._place.replace(list(live.values()))
            elif added or removed:
                self._place.write(list(added.values()), sorted(removed))
        except OSError:
            self._take_back(added, removed)
            raise
        with self._lock:
            self._writing = {}

    def _take_back(self, added: Mapping[_Key, JournalEntry], removed: set[_Key]) -> None:
        """The disk has refused; what it has of it nobody knows."""
        with self._lock:
            self._writing = {}
            self._gone |= removed
            self._unwritten = {key: entry for key, entry in added.items() if key in self._live} | self._unwritten
            self.unkept += len(self._unwritten.keys() - self._doubted)
            self._doubted |= self._unwritten.keys()

    def _refused(self, text: str) -> None:
        if text != self.problem:
            log.warning("reactions: what waits is in memory only: %s; trying again", text)
        self.problem = text

    def _give_up_unclaimed(self) -> None:
        with self._lock:
            left, self._left = self._left, {}
        for entry in [entry for entries in left.values() for entry in entries]:
            self._give_up(entry, "the settings do not ask for this reaction any more")

    def _give_up(self, entry: JournalEntry, reason: str) -> None:
        self._box.add(entry.name, entry.delivery.id, reason)
        self.done(*_key(entry))


class ReactionJournal:
    """The journal as one reaction sees it. `reaction`: its key; without a journal everything is in memory only."""

    def __init__(self, journal: DeliveryJournal | None = None, reaction: str = "", name: str = "") -> None:
        self._journal, self._reaction, self._name = journal, reaction, name

    def add(self, delivery: EdgeDelivery) -> None:
        """Keep it; never blocks."""
        if self._journal is not None:
            self._journal.add(self._reaction, self._name, delivery)

    def done(self, delivery: EdgeDelivery) -> None:
        """It is delivered or given up."""
        if self._journal is not None:
            self._journal.done(self._reaction, delivery.id)

    @property
    def settled(self) -> bool:
        """Whether it is known what a predecessor has left, or that nobody can know."""
        return self._journal is None or self._journal.settled.is_set()

    def wait(self, seconds: float) -> None:
        """Until it is settled, at most so long."""
        if self._journal is not None:
            self._journal.settled.wait(seconds)

    def left(self) -> Sequence[EdgeDelivery]:
        """What a predecessor has left, once."""
        return () if self._journal is None else self._journal.left(self._reaction)

    def outlives(self, delivery: EdgeDelivery) -> bool:
        """Whether the process is to end, and the next one will find it."""
        return self._journal is not None and self._journal.outlives(self._reaction, delivery.id)


def _key(entry: JournalEntry) -> _Key:
    return entry.reaction, entry.delivery.id


def _size(entry: JournalEntry) -> int:
    return ENTRY_BYTES + len(entry.delivery.body)
