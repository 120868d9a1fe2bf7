"""One subscription of a detector, and its match with the topic's publishers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from robotkube.robots.detector.core.liveness import FRESH, FreshnessBounds, freshness
from robotkube.robots.detector.core.settings import TopicSettings
from robotkube.robots.detector.loops.input_counters import InputCounter
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile, mismatch
from robotkube.robots.ros.core.ring_buffers import RingBuffer
from robotkube.robots.ros.core.source_clocks import AHEAD, BEHIND, DISORDERED, JUMPED, SILENT, STEADY

if TYPE_CHECKING:
    from robotkube.robots.detector.ports import TopicInput
    from robotkube.robots.recording.loops.recordings import Recordings

SOURCE_STATES = (STEADY, SILENT, AHEAD, BEHIND, JUMPED, DISORDERED)

Stamp = Callable[[bytes], int]


class _Counted(NamedTuple):
    """The counters that a subscription keeps itself."""

    lost: int = 0
    incompatible: int = 0
    missed_deadlines: int = 0
    lost_liveliness: int = 0


@dataclass
class TopicSubscription:
    """A subscription with everything its messages go to. `problem`: which publishers do not fit, and why."""

    name: str
    agent: str
    settings: TopicSettings
    input: TopicInput
    counter: InputCounter
    buffer: RingBuffer
    qos: QosProfile
    stamp: Stamp | None
    since: int
    offers: tuple[PublisherOffer, ...] = ()
    problem: str = ""
    matched: int = 0
    incompatible: IncompatiblePublishers = field(default_factory=IncompatiblePublishers)
    evaluated: bool = False
    lost_unseen: int = 0
    counted_before: _Counted = field(default_factory=_Counted)
    recordings: list[Recordings] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._continue_counting()
        self.lost_unseen = self.counter.lost

    @property
    def last_message_at(self) -> int:
        """The time of the last message, or else of the subscription; ns."""
        return max(self.counter.newest, self.since)

    def replace_input(self, fresh: TopicInput, qos: QosProfile) -> None:
        """Replace the subscription by another one, and go on counting."""
        self.count()
        self.input = fresh
        self.qos = qos
        self._continue_counting()

    def count(self) -> None:
        """Add the counters of the subscription; they only grow."""
        self.matched = self.input.matched
        refused = self.input.incompatible
        self.incompatible = refused if refused.publishers else self.incompatible
        before = self.counted_before
        counted = self._counts_of_input(refused)
        self.counter.lost = before.lost + counted.lost
        self.counter.incompatible = before.incompatible + counted.incompatible
        self.counter.missed_deadlines = before.missed_deadlines + counted.missed_deadlines
        self.counter.lost_liveliness = before.lost_liveliness + counted.lost_liveliness

    def close(self) -> None:
        """End the subscription."""
        self.count()
        self.input.close()

    def _continue_counting(self) -> None:
        before = self.counter
        counted = self._counts_of_input(self.input.incompatible)
        self.counted_before = _Counted(
            before.lost - counted.lost,
            before.incompatible - counted.incompatible,
            before.missed_deadlines - counted.missed_deadlines,
            before.lost_liveliness - counted.lost_liveliness,
        )

    def _counts_of_input(self, refused: IncompatiblePublishers) -> _Counted:
        return _Counted(self.input.lost, refused.publishers, *self.input.violations)


def of_type(topic: TopicSubscription, offers: Iterable[PublisherOffer]) -> list[PublisherOffer]:
    """The publishers of the topic's own type."""
    return [offer for offer in offers if offer.type == topic.settings.type]


def problem_of(topic: TopicSubscription, qos: QosProfile) -> str:
    """The publishers that would not match a subscription of that QoS profile, and why; empty when all do."""
    problems = (mismatch(topic.settings.type, qos, offer) for offer in topic.offers)
    return "; ".join(text for text in problems if text)


def topic_freshness(topic: TopicSubscription, last_message_at: int, now: int) -> str:
    """The freshness of a topic by the time of its last message (ns), within the topic's bounds."""
    bounds = FreshnessBounds(topic.settings.stale_seconds, topic.settings.expire_seconds)
    return freshness({topic.name: last_message_at}, now, bounds)[topic.name]


def source_state(topic: TopicSubscription, now: int) -> str:
    """The state of the topic's time at `now` (ns), one of SOURCE_STATES."""
    silent = not topic.settings.latched and topic_freshness(topic, topic.last_message_at, now) != FRESH
    return topic.buffer.clock.state(now, silent)


def topic_document(topic: TopicSubscription, now: int) -> dict[str, Any]:
    """The subscription as JSON values, as `/status` shows it."""
    counter = topic.counter
    return {
        "pattern": topic.settings.pattern.text,
        "agent": topic.agent,
        "type": topic.settings.type,
        "source": topic.settings.source,
        "matched": topic.matched,
        "asked": topic.qos.text(),
        "offered": [{"node": offer.node, "quality": offer.qos_profile.text()} for offer in topic.offers],
        "problem": topic.problem,
        "incompatible": {"count": counter.incompatible, "policy": topic.incompatible.policy},
        "missed_deadlines": counter.missed_deadlines,
        "lost_liveliness": counter.lost_liveliness,
        "state": source_state(topic, now),
        "offset_seconds": topic.buffer.clock.offset_ns() / 1e9,
        "stale": not topic.settings.latched and topic_freshness(topic, topic.last_message_at, now) != FRESH,
        "received": counter.received,
        "malformed": counter.malformed,
        "lost": counter.lost,
        "buffer": dict(topic.buffer.counters()),
    }
