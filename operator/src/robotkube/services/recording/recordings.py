"""A recording reaction: one recording for the whole time, or one per event with what came before and after it.

Called by one thread, which never waits here. Events whose windows overlap share a recording, which has them all as
causes. What came before an event is taken from the ring buffers; latched topics are in every recording.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.domain.audits import BUFFER, EVICTED, Gap, Interval
from robotkube.domain.buffers import RingBuffer, Sample
from robotkube.domain.recording_plans import (
    FOREVER,
    SECOND_NS,
    RecordedTopic,
    RecordingPlan,
    Trigger,
    Windows,
)
from robotkube.services.recording.journal import Journal
from robotkube.services.recording.places import BOUNDS, RecorderPlace, RecordingBounds
from robotkube.services.recording.recorder import Recorder

DEFINITIONS_BYTES_MAX = 4 * 1024 * 1024
"""A recording's document keeps definitions up to here; the database takes 16 MiB of it."""
LINGER_SECONDS = 2.0
"""How long messages are waited for whose stamps belong to a window that is over."""

log = logging.getLogger(__name__)


@dataclass
class _Open:
    """A recording that still takes messages; without `windows` it takes all. `until`: when it closes, ns."""

    recorder: Recorder
    windows: Windows | None = None
    until: int = FOREVER

    def keeps(self, topic: RecordedTopic, stamp: int) -> bool:
        return self.windows is None or self.windows.keeps(topic, stamp)


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
        self.plan, self._carried = plan, carried
        self._place, self._buffers, self._bounds = place, buffers, bounds
        self._journal = Journal(plan.recording, place, bounds)
        self._open: list[_Open] = []
        self._ending: list[Recorder] = []
        self._planned: dict[str, RecordedTopic | None] = {}
        self._ended: dict[str, int] = {}
        self._lock = threading.Lock()  # held while a recorder changes its list, so that nobody counts without it

    @property
    def ready(self) -> bool:
        """Whether claim and database have answered."""
        return self._journal.ready

    @property
    def failed(self) -> str:
        """An error of ours in words; empty when there was none."""
        parts: list[Recorder | Journal] = [self._journal, *self.recorders]
        return next((part.failed for part in parts if part.failed), "")

    @property
    def waiting(self) -> int:
        """Writes that neither database nor spool has taken yet."""
        return self._journal.waiting

    @property
    def recorders(self) -> list[Recorder]:
        """The recordings that are open or ending."""
        return [*(one.recorder for one in self._open), *self._ending]

    def counts(self) -> dict[str, int]:
        """What happened to messages and writes of all recordings since the start; numbers only grow."""
        with self._lock:
            found = dict(self._ended)
            for recorder in self.recorders:
                _add(found, recorder)
        journal = self._journal.counts
        found["dropped"] = found.get("dropped", 0) + journal.dropped
        written = {name: getattr(journal, name) for name in ("retries", "spooled", "repaired", "discarded")}
        return found | written

    def audits(self) -> dict[str, list[dict[str, Any]]]:
        """Recording -> audits of its topics so far, of those that are open or ending."""
        return {
            one.recording: one.audits() + [audit.document() for audit in self._journal.audits(one.recording)]
            for one in self.recorders
        }

    def start(self) -> None:
        """Connect; a plan for the whole time begins to record."""
        self._journal.start()
        if self.plan.always:
            document = self._document(self.plan.trace, self.plan.provenance)
            recorder = Recorder(
                self.plan.recording, document, self._journal, self._place, self.plan.streams, self._whole, self._bounds
            )
            self._begin(_Open(recorder))

    def offer(self, topic: str, type_name: str, sample: Sample) -> None:
        """Take a message in; never blocks."""
        if not self._open:
            return
        planned = self._topic(topic)
        if planned is None:
            return
        for one in self._open:
            if one.keeps(planned, sample.stamp):
                one.recorder.offer(topic, type_name, planned.storage, sample.stamp, sample.received, sample.data)

    def lack(self, gap: Gap) -> None:
        """Messages were given up before they came here; each open recording notes what lies in its window."""
        planned = self._topic(gap.topic)
        if planned is None:
            return
        for one in self._open:
            if one.windows is None:
                one.recorder.hear(gap)
                continue
            for part in _within(gap, one.windows.intervals(planned)):
                one.recorder.lack(part)

    def trigger(self, edge: Trigger, now: int) -> None:
        """An event of the plan's rule began; once more for the same event changes nothing."""
        if self.plan.always or any(one.windows and edge.id in one.windows.causes for one in self._open):
            return
        one = next((one for one in self._open if one.windows and one.windows.joins(edge)), None)
        fresh = one is None
        one = one or self._make(edge)
        assert one.windows is not None
        before = {topic: one.windows.intervals(topic) for topic in self.plan.topics}
        one.windows.begin(edge)
        one.until = FOREVER
        self._tell_causes(one)
        if fresh:
            self._begin(one)
        self._take_buffered(one, edge, before, fresh)
        log.info("recording %s: event %s joined=%s time=%d", one.recorder.recording, edge.id, not fresh, now)

    def end(self, edge: Trigger, now: int) -> None:
        """An event ended; its recording closes when what comes after it is over."""
        for one in self._open:
            if one.windows is None or edge.id not in one.windows.causes:
                continue
            one.windows.end(edge.id, edge.stamp)
            self._tell_causes(one)
            if not one.windows.running:
                after = max(topic.after_seconds for topic in self.plan.topics) + LINGER_SECONDS
                one.until = now + int(after * SECOND_NS)

    def tick(self, now: int) -> None:
        """Close what is over."""
        for one in [one for one in self._open if one.until <= now]:
            with self._lock:
                self._open.remove(one)
                self._ending.append(one.recorder)
            self._define(one.recorder)
            one.recorder.end()
        for recorder in [recorder for recorder in self._ending if recorder.stopped]:
            self._journal.forget(recorder)
            with self._lock:
                self._ending.remove(recorder)
                _add(self._ended, recorder)

    def stop(self, seconds: float) -> bool:
        """Store what was offered and end all recordings, within `seconds`; True when the database has everything.

        What the database does not take in time goes to the spool."""
        deadline = self._place.monotonic() + seconds
        recorders = self.recorders
        for recorder in recorders:
            self._define(recorder)
            recorder.end()
        stopped = [recorder.stop(max(0.1, deadline - self._place.monotonic())) for recorder in recorders]
        return self._journal.stop(max(0.1, deadline - self._place.monotonic())) and all(stopped)

    def _topic(self, name: str) -> RecordedTopic | None:
        if name not in self._planned:
            self._planned[name] = self.plan.topic(name)
        return self._planned[name]

    def _whole(self, name: str) -> Sequence[Interval]:
        """Where holes are looked for when there are no windows."""
        topic = self._topic(name)
        return () if topic is None or topic.latched else ((0, FOREVER),)

    def _make(self, edge: Trigger) -> _Open:
        windows = Windows(self.plan.topics)

        def spans(name: str) -> Sequence[Interval]:
            topic = self._topic(name)
            return () if topic is None or topic.latched else windows.intervals(topic)

        provenance = {"rule": edge.rule, "event": edge.id, "trace": edge.trace, **self.plan.provenance}
        document = self._document(self.plan.trace or edge.trace, provenance)
        name = self.plan.name(edge)
        return _Open(
            Recorder(name, document, self._journal, self._place, intervals=spans, bounds=self._bounds), windows
        )

    def _document(self, trace: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
        topics = self.plan.document_topics()
        whole = {"rule": self.plan.rule, "trace": trace, "provenance": dict(provenance), "topics": topics}
        return {**whole, **self._definitions()}

    def _define(self, recorder: Recorder) -> None:
        """Definitions may have come later than the recording's begin."""
        if found := self._definitions():
            recorder.update(found)

    def _definitions(self) -> dict[str, dict[str, str]]:
        found: dict[str, str] = {}
        for name in sorted({topic.type for topic in self.plan.topics}):
            text = self._carried(name)
            if text and sum(map(len, found.values())) + len(text) <= DEFINITIONS_BYTES_MAX:
                found[name] = text
        return {"definitions": found} if found else {}

    def _begin(self, one: _Open) -> None:
        self._open.append(one)
        one.recorder.start()

    def _tell_causes(self, one: _Open) -> None:
        assert one.windows is not None
        one.recorder.update({"causes": [cause.document() for cause in one.windows.causes.values()]})

    def _take_buffered(
        self, one: _Open, edge: Trigger, before: Mapping[RecordedTopic, Sequence[Interval]], fresh: bool
    ) -> None:
        """What the window of the event asks for and nobody has offered yet, and what the buffer has lost of it."""
        for name, buffer in list(self._buffers.items()):
            topic = self._topic(name)
            if topic is None:
                continue
            first, known = topic.window(edge.stamp, None)[0], before[topic]
            samples = buffer.since(0)
            if topic.latched:
                new = samples if fresh else []
            else:
                new = [s for s in samples if s.stamp >= first and not any(a <= s.stamp <= b for a, b in known)]
                self._note_eviction(one.recorder, name, buffer, first, samples)
            for sample in new:
                one.recorder.offer(name, topic.type, topic.storage, sample.stamp, sample.received, sample.data)

    def _note_eviction(
        self, recorder: Recorder, name: str, buffer: RingBuffer, first: int, samples: Sequence[Sample]
    ) -> None:
        left = buffer.evicted_seconds + buffer.evicted_bytes + buffer.evicted_count + buffer.evicted_process
        if samples and samples[0].stamp > first and left + buffer.cleared:
            recorder.lack(Gap(name, BUFFER, EVICTED, None, first, samples[0].stamp - 1))


def _within(gap: Gap, spans: Sequence[Interval]) -> Iterator[Gap]:
    """The parts of a gap that lie in these intervals; of a gap that was cut nobody knows how many messages it had."""
    for first, last in spans:
        begin, end = max(first, gap.first), min(last, gap.last)
        if begin <= end:
            whole = (begin, end) == (gap.first, gap.last)
            yield gap if whole else Gap(gap.topic, gap.where, gap.why, None, begin, end)


def _add(counts: dict[str, int], recorder: Recorder) -> None:
    for name, value in recorder.counts.numbers().items():
        counts[name] = counts.get(name, 0) + value
