"""A recording reaction: one recording for the whole time, or one per event with what came before and after it.

One thread calls it and never waits here. Events whose windows overlap share a recording, which has them all as
causes. What came before an event is copied from the ring buffers; latched topics are in every recording.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.robots.recording.core.audits import BUFFER, EVICTED
from robotkube.robots.recording.core.plans import FOREVER, SECOND_NS, RecordedTopic, RecordingPlan, Trigger, Windows
from robotkube.robots.recording.loops.destinations import BOUNDS, RecorderPlace, RecordingBounds
from robotkube.robots.recording.loops.journal import Journal
from robotkube.robots.recording.loops.recorder import Recorder
from robotkube.robots.ros.core.gaps import Gap, Interval
from robotkube.robots.ros.core.ring_buffers import RingBuffer, Sample

DEFINITIONS_BYTES_MAX = 4 * 1024 * 1024
"""A recording's document keeps definitions up to here; the database accepts 16 MiB of it."""
LINGER_SECONDS = 2.0
"""How long messages are waited for whose stamps belong to a window that is over."""
ENDED_MAX = 20
"""So many recordings that have ended are still told of."""

log = logging.getLogger(__name__)


@dataclass
class _OpenRecording:
    """An open recording; without `windows` it receives all messages. `until`: when it closes, ns."""

    recorder: Recorder
    windows: Windows | None = None
    until: int = FOREVER

    def contains(self, topic: RecordedTopic, stamp: int) -> bool:
        return self.windows is None or self.windows.contains(topic, stamp)


class Recordings:
    """All recordings of one plan. `start`, then `offer` every message, `trigger` and `end` with the edges of the rule,
    `tick` now and then, at last `stop`. `carried`: the definition of a type that came along with its messages, empty
    when none did; without it nobody could read them later."""

    def __init__(
        self,
        plan: RecordingPlan,
        place: RecorderPlace,
        buffers: Mapping[str, RingBuffer],
        bounds: RecordingBounds = BOUNDS,
        carried: Callable[[str], str] = lambda _: "",
    ) -> None:
        self.plan = plan
        self._carried = carried
        self._place = place
        self._buffers = buffers
        self._bounds = bounds
        self._journal = Journal(plan.recording, place, bounds)
        self._open_recordings: list[_OpenRecording] = []
        self._ending: list[Recorder] = []
        self._planned: dict[str, RecordedTopic | None] = {}
        self._ended: dict[str, int] = {}
        self._causes: dict[str, list[dict[str, Any]]] = {}  # of those that are open or ending
        self._ended_documents: deque[dict[str, Any]] = deque(maxlen=ENDED_MAX)
        self._lock = threading.Lock()  # held while a recorder changes its list, so that nobody counts without it

    @property
    def ready(self) -> bool:
        """Return whether volume claim and database have answered."""
        return self._journal.ready

    @property
    def failed(self) -> str:
        """An error of our own, in words; empty when there was none."""
        parts: list[Recorder | Journal] = [self._journal, *self.recorders]
        return next((part.failed for part in parts if part.failed), "")

    @property
    def waiting(self) -> int:
        """Writes that neither database nor spool has received yet."""
        return self._journal.waiting

    @property
    def recorders(self) -> list[Recorder]:
        """The recordings that are open or ending."""
        return [*(opened.recorder for opened in self._open_recordings), *self._ending]

    def counts(self) -> dict[str, int]:
        """Counters of messages and writes of all recordings since the start; numbers only grow."""
        with self._lock:
            counts = dict(self._ended)
            for recorder in self.recorders:
                _add(counts, recorder)
        journal = self._journal.counts
        counts["dropped"] = counts.get("dropped", 0) + journal.dropped
        written = {name: getattr(journal, name) for name in ("retries", "spooled", "repaired", "discarded")}
        return counts | written

    def audits(self) -> dict[str, list[dict[str, Any]]]:
        """Recording -> audits of its topics so far, of those that are open or ending."""
        return {
            recorder.recording: [
                *recorder.audits(),
                *(audit.document() for audit in self._journal.audits(recorder.recording)),
            ]
            for recorder in self.recorders
        }

    def documents(self) -> list[dict[str, Any]]:
        """The recordings that are open or ending, and the last ENDED_MAX that have ended; from any thread. Holes are
        looked for when an audit is closed, so the gaps of an open recording are those that were reported so far."""
        with self._lock:
            return [*self._ended_documents, *(self._summary(recorder) for recorder in self.recorders)]

    def _summary(self, recorder: Recorder, ended: int | None = None) -> dict[str, Any]:
        return {
            "recording": recorder.recording,
            "rule": self.plan.rule,
            "provenance": dict(self.plan.provenance),
            "volume": self._place.volume,
            "began": recorder.life,
            "ended": ended,
            "causes": self._causes.get(recorder.recording, []),
            "topics": recorder.audits(),
        }

    def start(self) -> None:
        """Connect; a plan for the whole time begins to record."""
        self._journal.start()
        if self.plan.always:
            document = self._document(self.plan.trace, self.plan.provenance)
            recorder = Recorder(
                self.plan.recording,
                document,
                self._journal,
                self._place,
                self.plan.streams,
                self._whole_time,
                self._bounds,
            )
            self._begin(_OpenRecording(recorder))

    def offer(self, topic: str, type_name: str, sample: Sample) -> None:
        """Give a message to the open recordings it belongs to; never blocks."""
        if not self._open_recordings:
            return
        planned = self._topic(topic)
        if planned is None:
            return
        for opened in self._open_recordings:
            if opened.contains(planned, sample.stamp):
                opened.recorder.offer(topic, type_name, planned.storage, sample.stamp, sample.received, sample.data)

    def note_gap(self, gap: Gap) -> None:
        """Note a gap, messages that were given up before they came here, in each open recording whose window has it."""
        planned = self._topic(gap.topic)
        if planned is None:
            return
        for opened in self._open_recordings:
            if opened.windows is None:
                opened.recorder.note_reported_gap(gap)
                continue
            for part in _within(gap, opened.windows.intervals(planned)):
                opened.recorder.note_gap(part)

    def trigger(self, edge: Trigger, now: int) -> None:
        """Record an event of the plan's rule that began, in a new recording or in the open one whose windows it
        overlaps; once more for the same event changes nothing."""
        windowed = [opened for opened in self._open_recordings if opened.windows]
        if self.plan.always or any(edge.id in opened.windows.causes for opened in windowed if opened.windows):
            return
        joined = next((opened for opened in windowed if opened.windows and opened.windows.overlaps(edge)), None)
        fresh = joined is None
        opened = joined or self._new_recording(edge)
        assert opened.windows is not None
        before = {topic: opened.windows.intervals(topic) for topic in self.plan.topics}
        opened.windows.begin(edge)
        opened.until = FOREVER
        self._update_causes(opened)
        if fresh:
            self._begin(opened)
        self._offer_buffered(opened, edge, before, fresh)
        log.info("recording %s: event %s joined=%s time=%d", opened.recorder.recording, edge.id, not fresh, now)

    def end(self, edge: Trigger, now: int) -> None:
        """End an event; its recording closes when the time to record after it is over."""
        for opened in self._open_recordings:
            if opened.windows is None or edge.id not in opened.windows.causes:
                continue
            opened.windows.end(edge.id, edge.stamp)
            self._update_causes(opened)
            if not opened.windows.running:
                after = max(topic.after_seconds for topic in self.plan.topics) + LINGER_SECONDS
                opened.until = now + int(after * SECOND_NS)

    def tick(self, now: int) -> None:
        """Close the recordings whose time is over."""
        for over in [opened for opened in self._open_recordings if opened.until <= now]:
            with self._lock:
                self._open_recordings.remove(over)
                self._ending.append(over.recorder)
            self._update_definitions(over.recorder)
            over.recorder.end()
        for recorder in [recorder for recorder in self._ending if recorder.stopped]:
            self._journal.remove_listener(recorder)
            with self._lock:
                self._ending.remove(recorder)
                _add(self._ended, recorder)
                self._ended_documents.append(self._summary(recorder, now))
                self._causes.pop(recorder.recording, None)

    def stop(self, seconds: float) -> bool:
        """Store what was offered and end all recordings, within `seconds`; True when the database has everything.

        What the database does not acknowledge in time goes to the spool."""
        deadline = self._place.monotonic() + seconds
        recorders = self.recorders
        for recorder in recorders:
            self._update_definitions(recorder)
            recorder.end()
        stopped = [recorder.stop(max(0.1, deadline - self._place.monotonic())) for recorder in recorders]
        return self._journal.stop(max(0.1, deadline - self._place.monotonic())) and all(stopped)

    def _topic(self, name: str) -> RecordedTopic | None:
        if name not in self._planned:
            self._planned[name] = self.plan.topic(name)
        return self._planned[name]

    def _whole_time(self, name: str) -> Sequence[Interval]:
        """The intervals in which holes are looked for when there are no windows."""
        topic = self._topic(name)
        return () if topic is None or topic.latched else ((0, FOREVER),)

    def _new_recording(self, edge: Trigger) -> _OpenRecording:
        windows = Windows(self.plan.topics)

        def spans(name: str) -> Sequence[Interval]:
            topic = self._topic(name)
            return () if topic is None or topic.latched else windows.intervals(topic)

        provenance = {"rule": edge.rule, "event": edge.id, "trace": edge.trace, **self.plan.provenance}
        document = self._document(self.plan.trace or edge.trace, provenance)
        name = self.plan.name(edge)
        return _OpenRecording(
            Recorder(name, document, self._journal, self._place, intervals=spans, bounds=self._bounds), windows
        )

    def _document(self, trace: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
        topics = self.plan.document_topics()
        whole = {"rule": self.plan.rule, "trace": trace, "provenance": dict(provenance), "topics": topics}
        return {**whole, **self._definitions()}

    def _update_definitions(self, recorder: Recorder) -> None:
        """Add definitions that may have come later than the recording's begin."""
        if definitions := self._definitions():
            recorder.update(definitions)

    def _definitions(self) -> dict[str, dict[str, str]]:
        definitions: dict[str, str] = {}
        for name in sorted({topic.type for topic in self.plan.topics}):
            text = self._carried(name)
            if text and sum(map(len, definitions.values())) + len(text) <= DEFINITIONS_BYTES_MAX:
                definitions[name] = text
        return {"definitions": definitions} if definitions else {}

    def _begin(self, opened: _OpenRecording) -> None:
        self._open_recordings.append(opened)
        opened.recorder.start()

    def _update_causes(self, opened: _OpenRecording) -> None:
        assert opened.windows is not None
        causes = [cause.document() for cause in opened.windows.causes.values()]
        self._causes[opened.recorder.recording] = causes
        opened.recorder.update({"causes": causes})

    def _offer_buffered(
        self, opened: _OpenRecording, edge: Trigger, before: Mapping[RecordedTopic, Sequence[Interval]], fresh: bool
    ) -> None:
        """Offer the buffered messages in the event's window that are not offered yet; note what the buffer has lost."""
        for name, buffer in list(self._buffers.items()):
            topic = self._topic(name)
            if topic is None:
                continue
            first, _ = topic.window(edge.stamp, None)
            known = before[topic]
            samples = buffer.since(0)
            if topic.latched:
                new = samples if fresh else []
            else:
                new = [s for s in samples if s.stamp >= first and not any(a <= s.stamp <= b for a, b in known)]
                self._note_eviction(opened.recorder, name, buffer, first, samples)
            for sample in new:
                opened.recorder.offer(name, topic.type, topic.storage, sample.stamp, sample.received, sample.data)

    def _note_eviction(
        self, recorder: Recorder, name: str, buffer: RingBuffer, first: int, samples: Sequence[Sample]
    ) -> None:
        left = buffer.evicted_seconds + buffer.evicted_bytes + buffer.evicted_count + buffer.evicted_process
        if samples and samples[0].stamp > first and left + buffer.cleared:
            recorder.note_gap(Gap(name, BUFFER, EVICTED, None, first, samples[0].stamp - 1))


def _within(gap: Gap, spans: Sequence[Interval]) -> Iterator[Gap]:
    """The parts of a gap that lie in these intervals; of a gap that was cut nobody knows how many messages it had."""
    for first, last in spans:
        begin = max(first, gap.first)
        end = min(last, gap.last)
        if begin <= end:
            whole = (begin, end) == (gap.first, gap.last)
            yield gap if whole else Gap(gap.topic, gap.where, gap.why, None, begin, end)


def _add(counts: dict[str, int], recorder: Recorder) -> None:
    for name, value in recorder.counts.numbers().items():
        counts[name] = counts.get(name, 0) + value
