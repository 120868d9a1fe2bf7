"""The recording reaction: everything offered is stored exactly once, and reception never waits for storage.

`offer` (called by the receiving thread) appends to a queue. One thread of the recorder takes batches: hash, drop
duplicates, append large messages to segments and synchronise them, then write buckets and index entries. While the
database is away, writes wait in memory, beyond `waiting_bytes_max` on the claim (spool), and are tried again. A
recording that ends without its database leaves the rest in the spool, from where the next recorder brings it in.

A recording begins when its streams flow: subscriptions of different topics are matched at different moments, and a
cloud without the poses of its time would only look like a loss. So large messages measured before the first message
of every stream are not stored; they are counted in `early`. A silent stream holds the begin up for BEGIN_SECONDS_MAX.
"""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robotkube.domain.detector_settings import RecordingReaction
from robotkube.domain.errors import InputError, UnavailableError
from robotkube.domain.recordings import (
    SEGMENT,
    Duplicates,
    Received,
    SegmentPlace,
    Write,
    bucket_documents,
    index_document,
)
from robotkube.services.ownership import Ownership

if TYPE_CHECKING:
    from robotkube.ports.recordings import RecordingStore, Segments, Spool

BATCH_SECONDS = 0.25
BATCH_BYTES = 4 * 1024 * 1024
BATCH_BYTES_MAX = 32 * 1024 * 1024
QUEUE_BYTES_MAX = 256 * 1024 * 1024
WAITING_BYTES_MAX = 64 * 1024 * 1024
RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX = 0.25, 5.0
WRITES_PER_ROUND_MAX = 2000
BEGIN_SECONDS_MAX = 3.0

SAMPLES, SEGMENTS, RECORDINGS = "samples", "segments_index", "recordings"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecorderPlace:
    """Where a recorder stores. The two openers are called on the recorder's own thread, so that importing and
    connecting do not delay the subscriptions; `volume` is `<node>/<claim>`. While `ownership` is not sure, nothing goes
    to the database."""

    volume: str
    open_store: Callable[[], RecordingStore]
    open_segments: Callable[[], tuple[Segments, Spool]]
    clock_ns: Callable[[], int]
    monotonic: Callable[[], float]
    ownership: Ownership = field(default_factory=Ownership)


@dataclass
class RecorderCounts:
    """What happened to the offered messages; numbers only grow. `first_stored`: topic -> time of its first index
    acknowledgement, ns."""

    offered: int = 0
    early: int = 0
    dropped: int = 0
    duplicates: int = 0
    documents: int = 0
    segments: int = 0
    retries: int = 0
    spooled: int = 0
    discarded: int = 0
    first_stored: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Offer:
    topic: str
    type: str
    storage: str
    stamp: int
    received: int
    data: bytes


class Recorder:
    """One recording. `start`, any number of `offer`, `stop`; then it is used up."""

    def __init__(
        self,
        reaction: RecordingReaction,
        place: RecorderPlace,
        topics: Mapping[str, Any],
        streams: frozenset[str] = frozenset(),
        waiting_bytes_max: int = WAITING_BYTES_MAX,
    ) -> None:
        self.reaction, self.counts = reaction, RecorderCounts()
        self._place, self._topics, self._waiting_bytes_max = place, dict(topics), waiting_bytes_max
        self._silent, self._begin_stamp = set(streams), 0
        self._first_large_at: float | None = None
        self._queue: deque[_Offer] = deque()
        self._batch: list[tuple[_Offer, Received]] = []
        self._offered_bytes = self._taken_bytes = 0
        self._woken_at_bytes = self._batch_began_bytes = 0
        self._wake = threading.Event()
        self._deadline: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"recorder-{reaction.recording}", daemon=True)
        self._store: RecordingStore | None = None
        self._segments: Segments | None = None
        self._spool: Spool | None = None
        self._duplicates = Duplicates()
        self._waiting: deque[Write] = deque()
        self._waiting_bytes = 0
        self._retry_seconds, self._retry_at = RETRY_SECONDS_FIRST, 0.0
        self._last_problem = ""
        self._doubtful: list[str] = []
        self.failed = ""

    @property
    def ready(self) -> bool:
        """Whether claim and database have answered."""
        return self._store is not None and self._segments is not None

    @property
    def waiting(self) -> int:
        """Writes that the database has not acknowledged yet."""
        return len(self._waiting)

    def start(self) -> None:
        """Start storing; connecting goes on beside."""
        self._thread.start()

    def offer(self, topic: str, type_name: str, storage: str, stamp: int, received: int, data: bytes) -> None:
        """Take a message in; never blocks. Beyond QUEUE_BYTES_MAX it is dropped and counted."""
        self.counts.offered += 1
        if topic in self._silent:
            self._silent.discard(topic)
            self._begin_stamp = max(self._begin_stamp, stamp)
        elif storage == SEGMENT and self._is_early(stamp):
            self.counts.early += 1
            return
        if self._offered_bytes - self._taken_bytes > QUEUE_BYTES_MAX:
            self.counts.dropped += 1
            return
        self._queue.append(_Offer(topic, type_name, storage, stamp, received, data))
        self._offered_bytes += len(data)
        first = storage == SEGMENT and topic not in self.counts.first_stored
        if first or self._offered_bytes - self._woken_at_bytes > BATCH_BYTES:
            self._woken_at_bytes = self._offered_bytes
            self._wake.set()

    def stop(self, seconds: float) -> bool:
        """Store what was offered and end the recording, within `seconds`; True when the database has everything.

        What the database does not take in time goes to the spool.
        """
        self._deadline = self._place.monotonic() + seconds
        self._wake.set()
        self._thread.join(seconds + 1.0)
        if self._thread.is_alive():
            log.error("recording %s: storing did not end within %.1f s", self.reaction.recording, seconds)
        rest = self._queue or self._batch or self._waiting or self.counts.spooled or self.counts.discarded
        return not (self._thread.is_alive() or rest)

    def _is_early(self, stamp: int) -> bool:
        if self._silent:
            now = self._place.monotonic()
            if self._first_large_at is None:
                self._first_large_at = now
            if now - self._first_large_at < BEGIN_SECONDS_MAX:
                return True
            log.warning("recording %s: begins without %s", self.reaction.recording, ", ".join(sorted(self._silent)))
            self._silent.clear()
        return stamp < self._begin_stamp

    # the recorder's own thread ---------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._work()
        except Exception as error:  # an error of ours: the process must not go on as if it recorded
            self.failed = f"recording {self.reaction.recording}: {type(error).__name__}: {error}"
            log.exception("%s", self.failed)
        finally:
            self._close_segment()  # rounds after the end may have begun another one
            if self._store is not None:
                self._store.close()

    def _work(self) -> None:
        while self._deadline is None:
            self._round()
            self._wake.wait(BATCH_SECONDS)
            self._wake.clear()
        self._finish(self._deadline)

    def _finish(self, deadline: float) -> None:
        self._round()
        self._close_segment()
        self._end()
        while (self._waiting or self._queue or self._batch) and self._place.monotonic() < deadline - 1.0:
            if self._place.ownership.lost:
                break
            self._retry_at = 0.0
            self._round()
            if self._waiting:
                self._wake.wait(RETRY_SECONDS_FIRST)
        if self._place.ownership.lost:
            self._discard()
        self._spool_waiting()
        log.info("recording %s: ended %s", self.reaction.recording, self._summary())

    def _discard(self) -> None:
        """Somebody else records meanwhile: what nobody was to be told since then is not told later either."""
        self.counts.discarded += len(self._waiting)
        self._waiting.clear()
        self._waiting_bytes = 0
        if self._spool is not None:
            for batch in self._doubtful:
                self._spool.remove(batch)
        log.warning("recording %s: taken over, %d writes are left out", self.reaction.recording, self.counts.discarded)

    def _close_segment(self) -> None:
        try:
            if self._segments is not None:
                self._segments.close()
        except OSError as error:
            log.exception("recording %s: closing the segment failed: %s", self.reaction.recording, error)

    def _end(self) -> None:
        if self._store is None:
            begun = {**self._document(), "volumes": [self._place.volume]}
            self._add(Write(RECORDINGS, self.reaction.recording, begun, size=1000))
        fields = {"ended": self._place.clock_ns(), "counts": self._numbers()}
        self._add(Write(RECORDINGS, self.reaction.recording, fields, update=True, size=200))

    def _round(self) -> None:
        """One batch. A failing part is logged and tried again in the next round; nothing taken is lost by it."""
        try:
            if self._segments is None:
                self._segments, self._spool = self._place.open_segments()
            if self._store is None and self._place.ownership.sure:
                self._open_store()
            if self._may_take():
                self._store_batch(self._segments)
            self._write_waiting()
        except OSError as error:
            self._problem(f"claim {self._place.volume}: {error}")

    def _may_take(self) -> bool:
        # what an earlier recorder of this recording stored must be known before anything is stored again;
        # when the database stays away for long, storing goes on: identifiers keep most duplicates out
        return (
            self._store is not None
            or self._offered_bytes - self._taken_bytes > self._waiting_bytes_max
            or (self._deadline is not None)
        )

    def _open_store(self) -> None:
        if self._place.monotonic() < self._retry_at:
            return
        store = self._place.open_store()
        try:
            self._take_up_spool(store)
            store.begin(self.reaction.recording, self._document(), self._place.volume)
            for topic, stamp, sha256 in store.known(self.reaction.recording):
                self._duplicates.admit(topic, stamp, sha256)
        except UnavailableError as error:
            store.close()
            self._later(error)
            return
        self._store = store
        log.info("recording %s: database reached", self.reaction.recording)

    def _document(self) -> dict[str, Any]:
        reaction = self.reaction
        return {
            "recording": reaction.recording,
            "rule": reaction.rule,
            "trace": reaction.trace,
            "provenance": dict(reaction.provenance),
            "topics": self._topics,
            "started": self._place.clock_ns(),
        }

    def _take_up_spool(self, store: RecordingStore) -> None:
        assert self._spool is not None
        for batch in self._spool.batches():
            try:
                writes = self._spool.read(batch)
            except InputError as error:
                log.error("recording %s: the spooled %s stays where it is: %s", self.reaction.recording, batch, error)
                continue
            store.write(writes)
            self._spool.remove(batch)
            self._acknowledged(writes)
            log.info("recording %s: brought in the spooled %s", self.reaction.recording, batch)

    def _store_batch(self, segments: Segments) -> None:
        """Large messages first: when the claim refuses them, the whole batch stays and is tried again."""
        self._take()
        large = [(offer, message) for offer, message in self._batch if offer.storage == SEGMENT]
        small = [message for offer, message in self._batch if offer.storage != SEGMENT]
        places = [(message, segments.append(message, offer.type)) for offer, message in large]
        segments.synchronise()
        self._batch = []
        self._add_index(places)
        for document in bucket_documents(self.reaction.recording, small):
            size = sum(len(sample["data"]) + 120 for sample in document["samples"])
            self._add(Write(SAMPLES, document["_id"], document, size=size))
        self.counts.documents += len(small)
        self.counts.segments += len(large)

    def _take(self) -> None:
        if self._batch:
            return
        for _ in range(len(self._queue)):
            offer = self._queue.popleft()
            self._taken_bytes += len(offer.data)
            digest = hashlib.sha256(offer.data).hexdigest()
            if self._duplicates.admit(offer.topic, offer.stamp, digest):
                self._batch.append((offer, Received(offer.topic, offer.stamp, offer.received, digest, offer.data)))
            if self._taken_bytes - self._batch_began_bytes > BATCH_BYTES_MAX:
                break
        self._batch_began_bytes = self._taken_bytes
        self.counts.duplicates = self._duplicates.dropped

    def _add_index(self, places: list[tuple[Received, SegmentPlace]]) -> None:
        for message, place in places:
            distinct = self._duplicates.shares_stamp(message.topic, message.stamp)
            document = index_document(self.reaction.recording, message, place, self._place.volume, distinct)
            self._add(Write(SEGMENTS, document["_id"], document, size=500))

    def _add(self, write: Write) -> None:
        self._waiting.append(write)
        self._waiting_bytes += write.size

    def _write_waiting(self) -> None:
        paused = self._place.monotonic() < self._retry_at or not self._place.ownership.sure
        if self._store is None or not self._waiting or paused:
            self._bound_waiting()
            return
        self._doubtful.clear()
        part = [self._waiting[index] for index in range(min(len(self._waiting), WRITES_PER_ROUND_MAX))]
        try:
            self._store.write(part)
        except UnavailableError as error:
            self.counts.retries += 1
            self._later(error)
            self._bound_waiting()
            return
        self._retry_seconds, self._last_problem = RETRY_SECONDS_FIRST, ""
        for write in part:
            self._waiting.popleft()
            self._waiting_bytes -= write.size
        self._acknowledged(part)

    def _acknowledged(self, part: Sequence[Write]) -> None:
        """Index entries are stored now: say so in the entries, at the next write, and once per topic in the log."""
        now = self._place.clock_ns()
        for write in part:
            if write.collection != SEGMENTS or write.update:
                continue
            self._add(Write(SEGMENTS, write.id, {"stored": now}, update=True, size=100))
            topic = write.document["topic"]
            if topic not in self.counts.first_stored and write.document["recording"] == self.reaction.recording:
                self.counts.first_stored[topic] = now
                log.info("recording %s: first message of %s stored=%d", self.reaction.recording, topic, now)

    def _bound_waiting(self) -> None:
        if self._waiting_bytes > self._waiting_bytes_max:
            self._spool_waiting()

    def _spool_waiting(self) -> None:
        if not self._waiting or self._spool is None:
            return
        try:
            self._doubtful.append(self._spool.put(self.reaction.recording, list(self._waiting)))
        except OSError as error:
            self._problem(f"spool on {self._place.volume}: {error}")
            return
        self.counts.spooled += len(self._waiting)
        log.warning("recording %s: %d writes are in the spool", self.reaction.recording, len(self._waiting))
        self._waiting.clear()
        self._waiting_bytes = 0

    def _later(self, error: Exception) -> None:
        self._retry_at = self._place.monotonic() + self._retry_seconds
        self._retry_seconds = min(self._retry_seconds * 2, RETRY_SECONDS_MAX)
        self._place.ownership.doubt()
        self._problem(str(error))

    def _problem(self, text: str) -> None:
        if text != self._last_problem:
            log.warning("recording %s: %s; trying again", self.reaction.recording, text)
        self._last_problem = text

    def _numbers(self) -> dict[str, int]:
        return {name: value for name, value in vars(self.counts).items() if isinstance(value, int)}

    def _summary(self) -> str:
        return " ".join(f"{name}={value}" for name, value in self._numbers().items())
