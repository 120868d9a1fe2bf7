"""One recording: hash, drop duplicates, append large messages to segments, add documents to the journal.

`offer` (called by the receiving thread) appends to a queue. The recorder's own thread empties it in batches. A message
is hashed beside the writing of the segment (hashing and writing let go of the interpreter), and a file is hashed as a
whole behind its messages, when they are safe already.

A recording that is asked to begins when its streams flow: subscriptions are matched at different moments, and a cloud
without the poses of its time would only look like a loss. So large messages measured before the first message of every
stream are not stored; they are counted in `early`. A silent stream holds the begin up for BEGIN_SECONDS_MAX.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from robotkube.errors import InputError
from robotkube.robots.recording.core.audits import QUEUE, VOLUME
from robotkube.robots.recording.core.documents import (
    AUDITS,
    INDEX,
    RECORDINGS,
    SAMPLES,
    SEGMENT,
    SEGMENTS,
    Duplicates,
    Received,
    SegmentMessage,
    SegmentPlace,
    Write,
    bucket_documents,
    messages_of,
    resumed_fields,
)
from robotkube.robots.recording.core.manifests import continued
from robotkube.robots.recording.core.plans import FOREVER
from robotkube.robots.recording.loops.counters import RecorderCounts
from robotkube.robots.recording.loops.destinations import BOUNDS, ROUND_SECONDS, RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.journal import Journal
from robotkube.robots.recording.loops.offers import (
    LargeMessage,
    Offer,
    PendingAppend,
    PriorContents,
    arrival,
    digest_of,
)
from robotkube.robots.recording.loops.recording_audits import RecordingAudits
from robotkube.robots.recording.loops.recording_manifest import RecordingManifest
from robotkube.robots.recording.loops.segment_repair import index_write, segment_begun, segment_ended
from robotkube.robots.recording.ports import NO_SPACE, RecordingStore, Segments
from robotkube.robots.ros.core.gaps import Gap, Interval

BATCH_BYTES = 4 * 1024 * 1024
BATCH_BYTES_MAX = 128 * 1024 * 1024
SETTLED_BYTES_PER_ROUND = 16 * 1024 * 1024
BEGIN_SECONDS_MAX = 3.0
KNOWN_SECONDS_MAX = 5.0
PRIOR_SECONDS_MAX = 2.0

log = logging.getLogger(__name__)


class Recorder:
    """One recording. `start`, any number of `offer` from one thread, `stop`; then it is used up.

    `document`: what the recording's document says beside its times. `intervals`: topic -> the stamps to look for
    holes in; asked when audits are closed. The journal outlives the recorder.
    """

    def __init__(
        self,
        recording: str,
        document: Mapping[str, Any],
        journal: Journal,
        place: RecorderPlace,
        streams: frozenset[str] = frozenset(),
        intervals: Callable[[str], Sequence[Interval]] = lambda _: ((0, FOREVER),),
        bounds: RecordingBounds = BOUNDS,
    ) -> None:
        self.recording = recording
        self.counts = RecorderCounts()
        self._document = dict(document)
        self._journal = journal
        self._place = place
        self._bounds = bounds
        self._audits = RecordingAudits(recording, journal, place, intervals)
        self._manifest = RecordingManifest(recording, self._audits.life, journal, place)
        self._earlier: Mapping[str, Any] | None = None
        self._silent = set(streams)
        self._begin_stamp = 0
        self._first_large_at: float | None = None
        self._queue: deque[Offer] = deque()
        self._large: list[LargeMessage] = []
        self._offered_bytes = self._settled_bytes = self._woken_at_bytes = 0
        self._wake = threading.Event()
        self._ending = threading.Event()
        self._segments: Segments | None = None
        self._duplicates = Duplicates()
        self._files = set[str]()
        self._begun = self._known = False
        self._lock = threading.Lock()
        self._prior: PriorContents | None = None
        self._prior_awaited_until = place.monotonic() + KNOWN_SECONDS_MAX
        self._volume_problem = self.failed = ""
        self._hashing = ThreadPoolExecutor(1, thread_name_prefix=f"hash-{recording}")
        self._writing = ThreadPoolExecutor(1, thread_name_prefix=f"write-{recording}")
        self._thread = threading.Thread(target=self._run, name=f"recorder-{recording}", daemon=True)
        journal.add_listener(self)

    def start(self) -> None:
        """Begin to store."""
        self._thread.start()

    def offer(self, topic: str, type_name: str, storage: str, stamp: int, received: int, data: bytes) -> None:
        """Queue a message; never blocks. Beyond the bound of the queue it is dropped, and the audit says so."""
        self.counts.offered += 1
        if topic in self._silent:
            self._silent.discard(topic)
            self._begin_stamp = max(self._begin_stamp, stamp)
        elif storage == SEGMENT and self._is_early(stamp):
            self.counts.early += 1
            self._audits.receive(topic, stamp, lambda audit: audit.count_early())
            return
        if self._offered_bytes - self._settled_bytes > self._bounds.queue_bytes:
            self.counts.dropped += 1
            why = self._volume_problem or "storing is too slow"
            self._audits.receive(topic, stamp, lambda audit: audit.drop(QUEUE, why, stamp))
            return
        self._queue.append(Offer(topic, type_name, storage, stamp, received, data))
        self._offered_bytes += len(data)
        first = storage == SEGMENT and topic not in self.counts.first_stored
        if first or self._offered_bytes - self._woken_at_bytes > BATCH_BYTES:
            self._woken_at_bytes = self._offered_bytes
            self._wake.set()

    def update(self, fields: Mapping[str, Any]) -> None:
        """Set fields of the recording's document, now or when it is made."""
        with self._lock:
            self._document.update(fields)
            if self._begun:
                self._journal.add([Write(RECORDINGS, self.recording, fields, update=True, size=1000)])

    def note_gap(self, gap: Gap) -> None:
        """Note a gap: messages that nobody can offer any more."""
        self._audits.note(gap.topic, lambda audit: audit.note_gap(gap))

    def note_reported_gap(self, gap: Gap) -> None:
        """Note a gap that somebody on the way reports; what was before the recording does not count."""
        self._audits.note_reported_gap(gap)

    def stop(self, seconds: float) -> bool:
        """Store what was offered and end the recording, within `seconds`; True when the journal has everything."""
        self._ending.set()
        self._wake.set()
        self._thread.join(seconds)
        if self._thread.is_alive():
            log.error("recording %s: storing did not end within %.1f s", self.recording, seconds)
        return not (self._thread.is_alive() or self._queue or self._large or self.failed)

    @property
    def life(self) -> int:
        """The time at which this recorder began, ns; it distinguishes its audits from those of earlier ones."""
        return self._audits.life

    @property
    def stopped(self) -> bool:
        """Return whether the recording has ended."""
        return not self._thread.is_alive()

    def end(self) -> None:
        """Store what was offered and end the recording; returns at once."""
        self._ending.set()
        self._wake.set()

    def audits(self) -> list[dict[str, Any]]:
        """The audit of every topic so far, without holes."""
        return self._audits.documents()

    def _is_early(self, stamp: int) -> bool:
        if self._silent:
            now = self._place.monotonic()
            if self._first_large_at is None:
                self._first_large_at = now
            if now - self._first_large_at < BEGIN_SECONDS_MAX:
                return True
            log.warning("recording %s: begins without %s", self.recording, ", ".join(sorted(self._silent)))
            self._silent.clear()
        return stamp < self._begin_stamp

    # called by the journal's thread ----------------------------------------------------------------------------------

    def introduce(self, store: RecordingStore) -> None:
        """Read what an earlier recorder of this recording has stored."""
        notes = self._manifest.earlier_notes()  # before: what is noted is in the database already
        self._prior = PriorContents(list(store.documents(self.recording)), notes)
        self._wake.set()

    def acknowledged(self, write: Write, now: int) -> None:
        """Count acknowledged messages; remember and log the first large one of each topic; note parts of manifests."""
        self._manifest.acknowledge(write)
        topic, stamps = messages_of(write)
        self.counts.acknowledged += len(stamps)
        if write.collection == INDEX and topic not in self.counts.first_stored:
            self.counts.first_stored[topic] = now
            log.info("recording %s: first message of %s stored=%d", self.recording, topic, now)

    # the recorder's own thread ---------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                self.turn()
                self._wake.wait(ROUND_SECONDS)
                self._wake.clear()
            self._await_prior()
            self.finish()
        except InputError as error:
            self.failed = f"recording {self.recording}: {error}"
            log.error("recording %s: %s", self.recording, error)
        except Exception as error:  # an error of our own: the process must not go on as if it recorded
            self.failed = f"recording {self.recording}: {type(error).__name__}: {error}"
            log.exception("%s", self.failed)
        finally:
            self._hashing.shutdown(wait=False)
            self._writing.shutdown(wait=False)

    def _await_prior(self) -> None:
        """Wait a moment for an earlier recorder's messages: the recording ends before the database has answered."""
        end = self._place.monotonic() + PRIOR_SECONDS_MAX
        while not (self._known or self._prior) and self._place.monotonic() < end:
            self._wake.wait(PRIOR_SECONDS_MAX / 20)
            self._wake.clear()

    def finish(self) -> None:
        """Store what is offered and end the recording; a volume that refuses now has refused for good."""
        self.turn()
        while self._queue:
            self.turn()
        self._end_large(self._begin_large())
        self._give_up()
        self._close_segment()
        if not self._begun and not self._audits:
            return
        self._begin()
        for audit in self._audits.close():
            self._manifest.add_document(AUDITS, audit)
        numbers = self.counts.numbers(self._journal.dropped(self.recording))
        fields = {"ended": self._place.clock_ns(), "counts": numbers}
        self._journal.add([Write(RECORDINGS, self.recording, fields, update=True, size=200)])
        self._manifest.seal(self._as_it_ends(fields), self._journal.volume_claim)
        log.info("recording %s: ended %s", self.recording, " ".join(f"{name}={n}" for name, n in numbers.items()))

    def _give_up(self) -> None:
        for large in self._large:
            self._drop(large.offer, self._volume_problem)
        self._large = []

    def _drop(self, offer: Offer, why: str) -> None:
        self.counts.dropped += 1
        self._audits.note(offer.topic, lambda audit: audit.drop(VOLUME, why, offer.stamp))

    def _close_segment(self) -> None:
        if self._segments is None:
            return
        try:
            self._segments.close()
        except OSError as error:
            log.error("recording %s: the segment has no end, the next start repairs it: %s", self.recording, error)
        self._add_closed(self._segments)

    def _as_it_ends(self, fields: Mapping[str, Any]) -> dict[str, Any] | None:
        """The recording's document when these fields are set; None when nobody knows what was there before."""
        with self._lock:
            own = {"started": self.life, **self._document, **fields}
        return None if self._earlier is None else continued(self._earlier, own)

    def _add_closed(self, segments: Segments) -> None:
        for closed in segments.closed():
            writes = segment_ended(self.recording, closed, self._place.volume)
            self._journal.add(writes)
            self._manifest.end_segment(closed.segment)
            self._manifest.add_document(SEGMENTS, writes[0].document)

    def turn(self) -> None:
        """Store one batch. A volume that refuses delays what it is for, and nothing else."""
        prior = self._prior
        self._prior = None
        if prior is not None:
            self._resume(prior)
        if not self._may_dequeue():
            return
        small = self._dequeue()
        if self._audits:
            self._begin()
        self._audits.write_changes(map(arrival, small), [arrival(large.offer) for large in self._large])
        large = self._begin_large()
        self._store_small(small)  # beside the writing of the large ones
        self._end_large(large)
        self._manifest.turn(self._journal.volume_claim)

    def _may_dequeue(self) -> bool:
        # what an earlier recorder of this recording stored must be known before anything is stored again;
        # when the database stays away for long, storing goes on: identifiers keep most duplicates out
        waiting = self._offered_bytes - self._settled_bytes
        late = waiting > self._bounds.waiting_bytes or self._place.monotonic() > self._prior_awaited_until
        return self._known or late or self._ending.is_set()

    def _resume(self, prior: PriorContents) -> None:
        """Go on after an earlier recorder of this recording, and find out since when it was interrupted."""
        stamps: dict[str, list[int]] = {}
        for topic, stamp, sha256 in prior.messages():
            self._duplicates.admit(topic, stamp, sha256)
            stamps.setdefault(topic, []).append(stamp)
        self._duplicates.dropped = 0
        prior.refuse_another_task(self._document)
        self._known = True
        self._earlier = prior.recording
        if prior.audits or stamps:
            self._audits.resume(prior.audits, stamps)
            self._begin()
        self._manifest.adopt(prior)

    def _dequeue(self) -> list[Offer]:
        """Empty the queue: large messages join those that the volume has not stored yet, small ones are returned."""
        small: list[Offer] = []
        batch_bytes = 0
        while self._queue and batch_bytes < BATCH_BYTES_MAX:
            offer = self._queue.popleft()
            batch_bytes += len(offer.data)
            self._audits.receive(offer.topic, offer.stamp)
            if offer.large:
                self._large.append(LargeMessage(offer, self._hashing.submit(digest_of, offer.data)))
            else:
                small.append(offer)
        return small

    def _store_small(self, offers: Sequence[Offer]) -> None:
        messages = []
        for offer in offers:
            self._settled_bytes += len(offer.data)
            digest = digest_of(offer.data)
            if self._duplicates.admit(offer.topic, offer.stamp, digest):
                messages.append(Received(offer.topic, offer.stamp, offer.received, digest, offer.data))
            else:
                self._count_duplicate(offer.topic)
        if not messages:
            return
        self._begin()
        buckets = bucket_documents(self.recording, messages)
        sizes = [sum(len(sample["data"]) + 120 for sample in bucket["samples"]) for bucket in buckets]
        writes = [Write(SAMPLES, bucket["_id"], bucket, size=n) for bucket, n in zip(buckets, sizes, strict=True)]
        self.counts.documents += len(messages)
        self._add_messages(writes, [message.topic for message in messages])

    def _count_duplicate(self, topic: str) -> None:
        self.counts.duplicates += 1
        self._audits.note(topic, lambda audit: audit.count_duplicate())

    def _add_messages(self, writes: Sequence[Write], topics: Sequence[str]) -> None:
        """Add writes that carry one message of each of `topics` to the journal."""
        self._journal.add(writes)
        self._manifest.add(writes)
        self._audits.store(topics)

    def _begin_large(self) -> PendingAppend | None:
        """Begin to write the messages that the volume has not stored yet."""
        if not self._large:
            return None
        try:
            if self._segments is None:
                self._segments = self._open_segments()
        except OSError as error:
            self._note_refusal(error)
            return None
        chosen = self._without_duplicates()
        return PendingAppend(self._segments, chosen, self._writing.submit(self._append, self._segments, chosen))

    def _end_large(self, begun: PendingAppend | None) -> None:
        if begun is None:
            return
        try:
            places = begun.places.result()
        except OSError as error:
            self._note_refusal(error)
            return
        self._volume_problem = ""
        self._add_index(begun.chosen, places)
        self._add_closed(begun.segments)
        self._settle(begun.segments)

    def _open_segments(self) -> Segments:
        if self._journal.volume_claim is None:
            raise OSError(f"volume claim {self._place.volume} has not answered yet")
        return self._journal.volume_claim.segments(self.recording)

    def _note_refusal(self, error: OSError) -> None:
        text = f"volume {self._place.volume}: {error}"
        if text != self._volume_problem:
            log.warning("recording %s: %s; trying again", self.recording, text)
        self._volume_problem = text
        if error.errno in NO_SPACE:
            self._journal.free_space()

    def _without_duplicates(self) -> list[LargeMessage]:
        """Large messages that are not stored yet. Only those of equal stamps are compared by their digests, which takes
        time."""
        chosen: list[LargeMessage] = []
        seen: dict[tuple[str, int], LargeMessage] = {}
        for large in self._large:
            key = arrival(large.offer)
            if key in seen or not (large.admitted or self._duplicates.fresh(*key)):
                if key in seen:
                    self._admit(seen[key])
                if not self._admit(large):
                    self._settled_bytes += len(large.offer.data)
                    self._count_duplicate(large.offer.topic)
                    continue
            seen[key] = large
            chosen.append(large)
        self._large = chosen
        return chosen

    def _admit(self, large: LargeMessage) -> bool:
        if not large.admitted:
            large.admitted = self._duplicates.admit(large.offer.topic, large.offer.stamp, large.digest.result())
        return large.admitted

    def _append(self, segments: Segments, chosen: Sequence[LargeMessage]) -> Sequence[SegmentPlace | None]:
        """Append messages; the place of each, as far as the volume stored them. None: no segment can hold it."""
        try:
            return segments.append([large.message() for large in chosen])
        except ValueError:
            return self._append_singly(segments, chosen)

    def _append_singly(self, segments: Segments, chosen: Sequence[LargeMessage]) -> list[SegmentPlace | None]:
        places: list[SegmentPlace | None] = []
        for large in chosen:
            try:
                places += segments.append([large.message()])
            except ValueError as error:
                log.error("recording %s: %s", self.recording, error)
                self._drop(large.offer, str(error))
                places.append(None)
            except OSError as error:
                self._note_refusal(error)
                break
        return places

    def _add_index(self, chosen: Sequence[LargeMessage], places: Sequence[SegmentPlace | None]) -> None:
        writes: list[Write] = []
        topics: list[str] = []
        for large, place in zip(chosen, places, strict=False):
            offer = large.offer
            self._settled_bytes += len(offer.data)
            if place is None:
                continue
            self._admit(large)
            digest = large.digest.result()
            stored = SegmentMessage(offer.topic, offer.stamp, offer.received, digest, len(offer.data), place)
            writes.append(index_write(self.recording, stored, self._place.volume, self._duplicates))
            topics.append(offer.topic)
        self._large = list(chosen[len(places) :])
        self.counts.segments += len(writes)
        if writes:
            self._begin()
            names = {place.segment for place in places if place is not None} - self._files
            self._files |= names
            for name in names:
                self._manifest.begin_segment(name)
            self._journal.add([segment_begun(self.recording, name, self._place.volume) for name in sorted(names)])
            self._add_messages(writes, topics)

    def _settle(self, segments: Segments) -> None:
        try:
            segments.settle(SETTLED_BYTES_PER_ROUND)
        except OSError as error:
            self._note_refusal(error)

    def _begin(self) -> None:
        """Make the recording's document, or open the one that is there again."""
        if self._begun:
            return
        volume = self._place.volume
        with self._lock:  # no update may come before the document
            self._begun = True
            document = {"recording": self.recording, **self._document, "started": self.life}
            begun = {**document, "volumes": [volume], "ended": None}
            added = {"volumes": volume}
            self._journal.add([
                Write(RECORDINGS, self.recording, begun, size=1000),
                Write(RECORDINGS, self.recording, resumed_fields(document), update=True, size=1000, add=added),
                self._manifest.begin(),
            ])  # fmt: skip
