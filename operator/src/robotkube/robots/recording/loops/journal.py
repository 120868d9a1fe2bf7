"""The writes of all recordings of a reaction, on their way to the database, in order.

While the database is unreachable they wait in memory; every SPOOL_SECONDS, or beyond a bound, they go to the spool on
the volume claim. When it is back the spool is written first, oldest file first. A full disk, a full spool or a volume
that refuses costs the oldest messages, which an audit of the journal's own names; documents that carry no message
(audits, ends) are never dropped.

While the release is fenced, the database counts as unreachable. When another process has taken the release over, what
was not written since then is discarded: the other one records, and its audits say so.
"""

from __future__ import annotations

import copy
import logging
import random
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from robotkube.backoffs import Random, backoff
from robotkube.errors import DocumentError, InputError, UnavailableError
from robotkube.robots.recording.core.audits import MEMORY, SPOOL, TopicAudit
from robotkube.robots.recording.core.documents import AUDITS, INDEX, Write, messages_of
from robotkube.robots.recording.loops.counters import JournalCounts
from robotkube.robots.recording.loops.destinations import ROUND_SECONDS, RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.segment_repair import repair_segments
from robotkube.robots.recording.ports import NO_SPACE

if TYPE_CHECKING:
    from robotkube.robots.recording.ports import RecordingStore, Spool, WritableVolume

RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 0.25, 5.0
WRITES_AT_ONCE_MAX = 2000
SPOOL_SECONDS = 5.0
AUDIT_BYTES = 2000
REFUSED, DISK_FULL, SPOOL_FULL, NO_SPOOL = (
    "refused by the database", "disk full", "spool full", "neither database nor volume",
)  # fmt: skip

log = logging.getLogger(__name__)

_Audits = dict[tuple[str, str], TopicAudit]
"""Recording and topic -> audit."""


class Listener(Protocol):
    """A recording whose writes go through the journal. Its methods are called by the journal's thread."""

    recording: str

    def introduce(self, store: RecordingStore) -> None:
        """Read what the database has of the recording, before anything new of it is written."""
        ...

    def acknowledged(self, write: Write, now: int) -> None:
        """Note that the database has this new document since `now`, ns."""
        ...


class Journal:
    """The queue of writes to one database, with a thread of its own. `start`, any number of `add` from any thread,
    `stop`; then it is used up."""

    def __init__(
        self, name: str, place: RecorderPlace, bounds: RecordingBounds, jitter: Random = random.random
    ) -> None:
        self._name = name
        self._place = place
        self._bounds = bounds
        self._jitter = jitter
        self.counts = JournalCounts()
        self.store: RecordingStore | None = None
        self.volume_claim: WritableVolume | None = None
        self.failed = ""
        self.life = place.clock_ns()
        self._spool: Spool | None = None
        self._unreachable_since = float("inf")
        self._last_durable: Write | None = None
        self._spooled = True
        self._repaired = self._ready = self._space_requested = False
        self._waiting: deque[Write] = deque()
        self._waiting_bytes = 0
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._deadline: float | None = None
        self._failures = 0
        self._retry_at = float("-inf")
        self._last_problem = ""
        self._audits: _Audits = {}
        self._urgent: _Audits = {}
        self._urgent_number = 0
        self._unconfirmed: dict[str, int] = {}  # batch -> its writes, spooled since the release was known to be ours
        self._listeners: dict[str, Listener] = {}
        self._to_introduce: deque[Listener] = deque()
        self._thread = threading.Thread(target=self._run, name=f"journal-{name}", daemon=True)

    @property
    def ready(self) -> bool:
        """Return whether volume claim and database have answered, and what an earlier process left is written."""
        return self._ready

    @property
    def waiting(self) -> int:
        """The number of writes that neither database nor spool has."""
        return len(self._waiting)

    @property
    def complete(self) -> bool:
        """Return whether the database has everything that was added."""
        return not (self._waiting or self._spooled or self.counts.discarded or self.failed)

    @property
    def _unwritten(self) -> bool:
        return bool(self._waiting or (self._spooled and self.counts.spooled))

    def start(self) -> None:
        """Start the journal's thread, which connects."""
        self._thread.start()

    def add_listener(self, listener: Listener) -> None:
        """Introduce a recording to the database, and notify it of what is acknowledged."""
        self._listeners[listener.recording] = listener
        self._to_introduce.append(listener)
        self._wake.set()

    def remove_listener(self, listener: Listener) -> None:
        """Notify a recording no more."""
        if self._listeners.get(listener.recording) is listener:
            del self._listeners[listener.recording]

    def add(self, writes: Iterable[Write], durable: bool = False) -> None:
        """Queue writes; never blocks. `durable`: they must be found after a kill, too, so they go to the spool at once
        when the database is unreachable."""
        with self._lock:
            for write in writes:
                self._waiting.append(write)
                self._waiting_bytes += write.size
                self._last_durable = write if durable else self._last_durable
        self._wake.set()

    def dropped(self, recording: str) -> int:
        """The number of messages of the recording that the journal has given up."""
        return sum(audit.dropped for (name, _), audit in list(self._audits.items()) if name == recording)

    def audits(self, recording: str) -> list[TopicAudit]:
        """The audits of what the journal has given up of a recording, one per topic."""
        return [audit for (name, _), audit in list(self._audits.items()) if name == recording]

    def free_space(self) -> None:
        """Request space on a full disk: the oldest file of the spool is given up."""
        self._space_requested = True
        self._wake.set()

    def stop(self, seconds: float) -> bool:
        """Write what waits, within `seconds`; True when the database has everything. The rest goes to the spool."""
        self._deadline = self._place.monotonic() + seconds
        self._wake.set()
        self._thread.join(seconds + 1.0)
        if self._thread.is_alive():
            log.error("recording %s: writing did not end within %.1f s", self._name, seconds)
        return not self._thread.is_alive() and self.complete

    # the journal's own thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while self._deadline is None:
                self.turn()
                self._wake.wait(ROUND_SECONDS)
                self._wake.clear()
            self.finish(self._deadline)
        except Exception as error:  # an error of our own: the process must not go on as if it recorded
            self.failed = f"recording {self._name}: {type(error).__name__}: {error}"
            log.exception("%s", self.failed)
        finally:
            self._close_store()

    def finish(self, deadline: float) -> None:
        """Write what waits until `deadline`, and spool the rest."""
        self.turn()
        while self._unwritten and not self._place.fencing.lost and self._place.monotonic() < deadline - 1.0:
            self._retry_at = float("-inf")
            self.turn()
            if self._unwritten:
                self._wake.wait(backoff(0, RETRY_SECONDS_FIRST, RETRY_SECONDS_FIRST, self._jitter))
        if self._place.fencing.lost:
            self._discard()
        self._spool_waiting()
        if self._waiting:
            log.error("recording %s: %d writes are lost: neither database nor volume", self._name, len(self._waiting))

    def _discard(self) -> None:
        """Discard what was added since the release became another process's, which records it."""
        with self._lock:
            self.counts.discarded += len(self._waiting)
            self._waiting.clear()
            self._waiting_bytes = 0
        self._urgent.clear()
        try:
            while self._unconfirmed and self._spool is not None:
                batch, writes = self._unconfirmed.popitem()
                self._spool.remove(batch)
                self.counts.discarded += writes
        except OSError as error:
            self._log_problem(f"spool on {self._place.volume}: {error}")
        log.warning("recording %s: taken over, %d writes are left out", self._name, self.counts.discarded)

    def turn(self) -> None:
        """Do what can be done now."""
        try:
            if self.volume_claim is None:
                volume_claim = self._place.open_volume_claim()
                self._spool = volume_claim.spool()
                self.volume_claim = volume_claim
            if self._space_requested:
                self._space_requested = False
                self._drop_oldest(DISK_FULL)
        except OSError as error:
            self._log_problem(f"volume claim {self._place.volume}: {error}")
        if self._place.monotonic() >= self._retry_at:
            self._use_database()
        self._bound_waiting()

    def _use_database(self) -> None:
        """Do everything that needs the database, unless it is unreachable or the release is fenced."""
        try:
            if not self._place.fencing.fenced:
                self._unconfirmed.clear()
            if self.store is None:
                self._open_store()
            if self._place.fencing.fenced:
                self._unreachable_since = min(self._unreachable_since, self._place.monotonic())
                return
            if self.store is not None:
                self._write_urgent(self.store)
                self._recover(self.store)
                self._introduce(self.store)
                while self._waiting and not self._place.fencing.fenced:
                    self._write_part(self.store)
                self._ready = self._repaired and not self._to_introduce
        except UnavailableError as error:
            self.counts.retries += 1
            pause = backoff(self._failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter)
            self._failures += 1
            self._retry_at = self._place.monotonic() + pause
            self._unreachable_since = min(self._unreachable_since, self._place.monotonic())
            self._place.fencing.interrupted()
            self._close_store()
            self._log_problem(str(error))
        except OSError as error:
            self._log_problem(f"volume claim {self._place.volume}: {error}")
        else:
            self._failures = 0
            self._last_problem = ""
            self._unreachable_since = float("inf")

    def _open_store(self) -> None:
        store = self._place.open_store()
        try:
            store.ping()
        except UnavailableError:
            store.close()
            raise
        self.store = store
        log.info("recording %s: database reached", self._name)

    def _close_store(self) -> None:
        """Leave the database: the next try goes by the account as it is then, which may have changed meanwhile."""
        if self.store is not None:
            self.store.close()
            self.store = None

    def _recover(self, store: RecordingStore) -> None:
        """Write what earlier processes left: their spool, then the messages of segments that nobody finished."""
        if self._spool is None or self.volume_claim is None:
            return
        if self._spooled:
            self._drain_spool(store, self._spool)
        if not self._repaired:
            for writes in repair_segments(self.volume_claim.repairs(), store, self._place.volume):
                self._write(store, writes)
                self.counts.repaired += sum(write.collection == INDEX for write in writes)
            self._repaired = True

    def _introduce(self, store: RecordingStore) -> None:
        if not self._repaired:
            return
        while self._to_introduce:
            self._to_introduce[0].introduce(store)
            self._to_introduce.popleft()

    def _drain_spool(self, store: RecordingStore, spool: Spool) -> None:
        for batch in [batch.name for batch in spool.batches()]:
            try:
                writes = spool.read(batch)
            except InputError as error:
                log.error("recording %s: the spooled %s stays where it is: %s", self._name, batch, error)
                continue
            self._write(store, writes)
            spool.remove(batch)
            log.info("recording %s: wrote the spooled %s", self._name, batch)
        self._spooled = False

    def _write_urgent(self, store: RecordingStore) -> None:
        """Write the audits of what is missing, before what comes after it."""
        if self._urgent:
            self._write(store, self._audit_writes(self._urgent, f"{self._urgent_number}"))
            self._count_urgent()

    def _write_part(self, store: RecordingStore) -> None:
        with self._lock:
            part = [self._waiting[index] for index in range(min(len(self._waiting), WRITES_AT_ONCE_MAX))]
        self._write(store, part)
        with self._lock:
            for write in part:
                self._waiting.popleft()
                self._waiting_bytes -= write.size

    def _write(self, store: RecordingStore, writes: Sequence[Write]) -> None:
        try:
            store.write(writes)
        except DocumentError:
            self._write_singly(store, writes)
        else:
            self._acknowledge(writes)

    def _write_singly(self, store: RecordingStore, writes: Sequence[Write]) -> None:
        """Write one by one, and give up the documents that the database can never accept."""
        for write in writes:
            try:
                store.write([write])
            except DocumentError as error:
                log.error("recording %s: %s %s: %s", self._name, write.collection, write.id, error)
                self._audit_lost([write], MEMORY, REFUSED, self._urgent)
            else:
                self._acknowledge([write])

    def _acknowledge(self, writes: Sequence[Write]) -> None:
        """Note acknowledged writes: in their index entries, by the next write, and at their listeners."""
        now = self._place.clock_ns()
        self.counts.acknowledged += len(writes)
        for write in writes:
            if write.update:
                continue
            if write.collection == INDEX:
                self.add([Write(INDEX, write.id, {"stored": now}, update=True, size=100)])
            listener = self._listeners.get(write.document["recording"])
            if listener is not None:
                listener.acknowledged(write, now)

    # bounds ----------------------------------------------------------------------------------------------------------

    def _bound_waiting(self) -> None:
        unreachable = self._place.monotonic() - self._unreachable_since
        urgent = unreachable > SPOOL_SECONDS or (unreachable >= 0 and self._durable_waits())
        if not (urgent or self._waiting_bytes > self._bounds.waiting_bytes):
            return
        # what was added while the spool was written is the next turn's: only a volume that refuses costs messages
        if not self._spool_waiting() and self._waiting_bytes > 2 * self._bounds.waiting_bytes:
            self._drop_waiting()

    def _durable_waits(self) -> bool:
        """Return whether durable writes still wait."""
        with self._lock:
            return any(write is self._last_durable for write in self._waiting)

    def _spool_waiting(self) -> bool:
        """Write everything that waits to one file of the spool, on a full disk in place of the oldest files; whether
        the volume has it now."""
        with self._lock:
            writes = list(self._waiting)
        if self._spool is None:
            return False
        if not writes:
            return True
        try:
            while not (batch := self._put_batch(self._spool, writes)):
                pass
        except OSError as error:
            self._log_problem(f"spool on {self._place.volume}: {error}")
            return False
        self._spooled = True
        self._unreachable_since = self._place.monotonic()
        self._count_urgent()
        self._unconfirmed[batch] = len(writes)
        self.counts.spooled += len(writes)
        log.warning("recording %s: %d writes are in the spool", self._name, len(writes))
        with self._lock:
            for write in writes:
                self._waiting.popleft()
                self._waiting_bytes -= write.size
        try:
            self._bound_spool(self._spool)
        except OSError as error:
            self._log_problem(f"spool on {self._place.volume}: {error}")
        return True

    def _put_batch(self, spool: Spool, writes: Sequence[Write]) -> str:
        """Spool writes; the batch's name, empty when space was freed to try again. OSError when none can be freed."""
        try:
            return spool.put([*self._audit_writes(self._urgent, f"{self._urgent_number}"), *writes])
        except OSError as error:
            if error.errno in NO_SPACE and self._drop_oldest(DISK_FULL):
                return ""
            raise

    def _bound_spool(self, spool: Spool) -> None:
        size = sum(batch.size for batch in spool.batches())
        while size > self._bounds.spool_bytes and self._drop_oldest(SPOOL_FULL):
            size = sum(batch.size for batch in spool.batches())

    def _drop_oldest(self, why: str) -> bool:
        """Give up the messages of the oldest file of the spool; False when no file has any.

        Its audits take the file's place, so that they are written before what came later."""
        spool = self._spool
        name = next((batch.name for batch in spool.batches() if not batch.given_up), "") if spool else ""
        if not spool or not name:
            return False
        try:
            writes = spool.read(name)
        except InputError as error:
            log.error("recording %s: nobody knows what was in the spooled %s: %s", self._name, name, error)
            writes = ()
        audits_before = copy.deepcopy(self._audits)
        dropped_before = self.counts.dropped
        lost: _Audits = {}
        self._audit_lost(writes, SPOOL, f"{why}: {name}", lost)
        audits = self._audit_writes(lost, name)
        try:
            spool.give_up(name, [*audits, *(write for write in writes if not messages_of(write)[1])])
        except OSError:
            self._audits = audits_before
            self.counts.dropped = dropped_before
            raise
        self._unconfirmed.pop(name, None)
        log.error("recording %s: gave up the oldest of the spool, %s: %s", self._name, name, why)
        return True

    def _drop_waiting(self) -> None:
        """Give up the oldest messages, and audits that later ones replace: there is neither database nor volume."""
        with self._lock:
            latest = {(write.id, write.update): number for number, write in enumerate(self._waiting)}
            excess = self._waiting_bytes - 2 * self._bounds.waiting_bytes
            lost: list[Write] = []
            remaining: list[Write] = []
            for number, write in enumerate(self._waiting):
                replaced = write.collection == AUDITS and latest[write.id, write.update] != number
                if excess > 0 and (replaced or messages_of(write)[1]):
                    excess -= write.size
                    lost.append(write)
                else:
                    remaining.append(write)
            self._waiting = deque(remaining)
            self._waiting_bytes = sum(write.size for write in remaining)
        self._audit_lost(lost, MEMORY, NO_SPOOL, self._urgent)

    def _audit_lost(
        self, writes: Sequence[Write], where: str, why: str, audits: dict[tuple[str, str], TopicAudit]
    ) -> None:
        """Note the messages of writes that are given up in `audits` and in the journal's own."""
        for write in writes:
            topic, stamps = messages_of(write)
            if not stamps:
                continue
            key = write.document["recording"], topic
            for known in (audits, self._audits):
                audit = known.setdefault(key, TopicAudit(topic))
                for stamp in stamps:
                    audit.drop(where, why, stamp)
            self.counts.dropped += len(stamps)

    def _audit_writes(self, audits: Mapping[tuple[str, str], TopicAudit], event: str) -> list[Write]:
        """The writes of one event's audits as they are now; they may have been written before, and have grown since."""
        writes = []
        for (recording, topic), audit in sorted(audits.items()):
            name = f"{recording}{topic}/{self.life}-{event}"
            document: dict[str, Any] = {**audit.document(), "closed": True, "written": self._place.clock_ns()}
            whole = {"recording": recording, "volume": self._place.volume, "life": self.life, **document}
            writes.append(Write(AUDITS, name, whole, size=AUDIT_BYTES))
            writes.append(Write(AUDITS, name, document, update=True, size=AUDIT_BYTES))
        return writes

    def _count_urgent(self) -> None:
        self._urgent.clear()
        self._urgent_number += 1

    def _log_problem(self, text: str) -> None:
        if text != self._last_problem:
            log.warning("recording %s: %s; trying again", self._name, text)
        self._last_problem = text
