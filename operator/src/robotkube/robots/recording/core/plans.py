"""The plan of a recording: which topics it keeps, how, and which stretch of time around its causes. Pure.

Stamps are integers in ns since 1970, both ends of an interval included.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from robotkube.robots.ros.core.gaps import Interval
from robotkube.robots.ros.core.topic_patterns import TopicPattern

FOREVER = 2**63 - 1
CAUSES_MAX = 1000
SECOND_NS = 1_000_000_000


class Trigger(Protocol):
    """An edge of an event, as far as recordings care. `time`: when it was dispatched, `stamp`: when it happened, ns."""

    @property
    def id(self) -> str: ...
    @property
    def rule(self) -> str: ...
    @property
    def agents(self) -> tuple[str, ...]: ...
    @property
    def trace(self) -> str: ...
    @property
    def stamp(self) -> int: ...
    @property
    def time(self) -> int: ...


@dataclass(frozen=True)
class RecordedTopic:
    """A topic, or one per agent when `pattern` holds `{agent}`. `storage`: document | segment. An event's window begins
    `before_seconds` before its start and ends `after_seconds` after its end; a latched topic has no window."""

    pattern: TopicPattern
    type: str
    storage: str
    before_seconds: float = 0.0
    after_seconds: float = 0.0
    latched: bool = False

    def document(self) -> dict[str, Any]:
        """The plan as it stands in the recording's document."""
        return {"type": self.type, "storage": self.storage, **({"latched": True} if self.latched else {})}

    def window(self, started: int, stopped: int | None) -> Interval:
        """The stamps to keep for an event; it has no end yet when `stopped` is None."""
        first = started - int(self.before_seconds * SECOND_NS)
        return first, FOREVER if stopped is None else stopped + int(self.after_seconds * SECOND_NS)


@dataclass(frozen=True)
class RecordingPlan:
    """A recording reaction. With `always` there is one recording, named `recording`, from the begin of the process to
    its end; else there is one per event, or per events whose windows overlap, named `<recording>-<event>`."""

    rule: str
    recording: str
    volume: str
    topics: tuple[RecordedTopic, ...]
    always: bool = True
    after_seconds: float = 0.0
    trace: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def topic(self, name: str) -> RecordedTopic | None:
        """The plan for the topic of this name; None: it is not recorded."""
        return next((topic for topic in self.topics if topic.pattern.agent(name) is not None), None)

    @property
    def streams(self) -> frozenset[str]:
        """The topics whose first message belongs to the recording's begin: small, one by name, said again and again."""
        return frozenset(
            topic.pattern.text
            for topic in self.topics
            if topic.storage == "document" and not topic.latched and not topic.pattern.general
        )

    def name(self, trigger: Trigger) -> str:
        """The recording that this event begins: equal events give equal names."""
        return f"{self.recording}-{trigger.id[:8]}"

    def document_topics(self) -> dict[str, dict[str, Any]]:
        """`topics` of the recording's document."""
        return {topic.pattern.text: topic.document() for topic in self.topics}


@dataclass
class RecordingCause:
    """An event that a recording was made for. `stopped` is None while it lasts."""

    trigger: Trigger
    stopped: int | None = None

    def document(self) -> dict[str, Any]:
        """The plan as it stands in the recording's document."""
        trigger = self.trigger
        return {
            "event": trigger.id,
            "rule": trigger.rule,
            "agents": list(trigger.agents),
            "trace": trigger.trace,
            "started": trigger.stamp,
            "stopped": self.stopped,
        }


class Windows:
    """The causes of one recording and what they ask for, topic by topic."""

    def __init__(self, topics: tuple[RecordedTopic, ...]) -> None:
        self._topics = topics
        self.causes: dict[str, RecordingCause] = {}
        self._intervals: dict[str, tuple[Interval, ...]] = {}

    @property
    def running(self) -> bool:
        """Return whether a cause has not ended."""
        return any(cause.stopped is None for cause in self.causes.values())

    @property
    def last(self) -> int:
        """The last stamp that anybody asks for."""
        return max((last for spans in self._intervals.values() for _, last in spans), default=0)

    def begin(self, trigger: Trigger) -> None:
        """Add a cause."""
        self.causes[trigger.id] = RecordingCause(trigger)
        self._update_intervals()

    def end(self, event: str, stamp: int) -> None:
        """End a cause at `stamp`; not before it began."""
        cause = self.causes[event]
        cause.stopped = max(stamp, cause.trigger.stamp)
        self._update_intervals()

    def overlaps(self, trigger: Trigger) -> bool:
        """Return whether the window of a new event overlaps or touches this recording's in any topic."""
        return len(self.causes) < CAUSES_MAX and any(
            topic.window(trigger.stamp, None)[0] <= last + 1
            for topic in self._topics
            for _, last in self.intervals(topic)
        )

    def intervals(self, topic: RecordedTopic) -> tuple[Interval, ...]:
        """What is kept of a topic, oldest first; intervals neither overlap nor touch."""
        return self._intervals.get(topic.pattern.text, ())

    def contains(self, topic: RecordedTopic, stamp: int) -> bool:
        """Return whether a message of this stamp belongs to the recording."""
        return topic.latched or any(first <= stamp <= last for first, last in self.intervals(topic))

    def _update_intervals(self) -> None:
        for topic in self._topics:
            windows = sorted(topic.window(cause.trigger.stamp, cause.stopped) for cause in self.causes.values())
            self._intervals[topic.pattern.text] = tuple(_joined(windows))


def _joined(intervals: list[Interval]) -> Iterator[Interval]:
    present: Interval | None = None
    for first, last in intervals:
        if present is not None and first <= present[1] + 1:
            present = present[0], max(present[1], last)
            continue
        if present is not None:
            yield present
        present = first, last
    if present is not None:
        yield present
