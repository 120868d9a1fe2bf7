"""One subscription of a detector, and how its publishers suit it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from robotkube.domain.buffers import RingBuffer
from robotkube.domain.detector_settings import TopicSettings
from robotkube.domain.freshness import FRESH, FreshnessBounds, freshness
from robotkube.domain.qualities import Incompatible, Offer, Quality, mismatch
from robotkube.services.detector.counting import InputCounter

if TYPE_CHECKING:
    from robotkube.ports.robots import TopicInput
    from robotkube.services.recording.recordings import Recordings

Stamp = Callable[[bytes], int]


class _Counted(NamedTuple):
    """What a subscription counts of itself."""

    lost: int = 0
    incompatible: int = 0
    missed_deadlines: int = 0
    lost_liveliness: int = 0


@dataclass
class Topic:
    """A subscription with everything its messages go to. `problem`: which publishers do not fit, and why."""

    name: str
    agent: str
    settings: TopicSettings
    input: TopicInput
    counter: InputCounter
    buffer: RingBuffer
    quality: Quality
    stamp: Stamp | None
    since: int
    offers: tuple[Offer, ...] = ()
    problem: str = ""
    matched: int = 0
    incompatible: Incompatible = field(default_factory=Incompatible)
    evaluated: bool = False
    counted_before: _Counted = field(default_factory=_Counted)
    recordings: list[Recordings] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._go_on_counting()

    @property
    def heard(self) -> int:
        """When something came last, or the subscription was made; ns."""
        return max(self.counter.newest, self.since)

    def take_over(self, fresh: TopicInput, quality: Quality) -> None:
        """Go on with another subscription, which has taken the place of this one."""
        self.count()
        self.input, self.quality = fresh, quality
        self._go_on_counting()

    def count(self) -> None:
        """Note what the subscription says of itself; counters only grow."""
        self.matched, refused = self.input.matched, self.input.incompatible
        self.incompatible = refused if refused.publishers else self.incompatible
        before, said = self.counted_before, self._said(refused)
        self.counter.lost = before.lost + said.lost
        self.counter.incompatible = before.incompatible + said.incompatible
        self.counter.missed_deadlines = before.missed_deadlines + said.missed_deadlines
        self.counter.lost_liveliness = before.lost_liveliness + said.lost_liveliness

    def close(self) -> None:
        """Unsubscribe."""
        self.count()
        self.input.close()

    def _go_on_counting(self) -> None:
        before, said = self.counter, self._said(self.input.incompatible)
        self.counted_before = _Counted(
            before.lost - said.lost,
            before.incompatible - said.incompatible,
            before.missed_deadlines - said.missed_deadlines,
            before.lost_liveliness - said.lost_liveliness,
        )

    def _said(self, refused: Incompatible) -> _Counted:
        return _Counted(self.input.lost, refused.publishers, *self.input.broken)


def of_type(topic: Topic, offers: Iterable[Offer]) -> list[Offer]:
    """Publishers of another type are none of its."""
    return [offer for offer in offers if offer.type == topic.settings.type]


def problem_of(topic: Topic, quality: Quality) -> str:
    """Which publishers would not fit a subscription of that quality, and why; empty when all do."""
    found = (mismatch(topic.settings.type, quality, offer) for offer in topic.offers)
    return "; ".join(text for text in found if text)


def how_fresh(topic: Topic, heard: int, now: int) -> str:
    """By when something was heard last (ns), within the topic's bounds."""
    bounds = FreshnessBounds(topic.settings.stale_seconds, topic.settings.expire_seconds)
    return freshness({topic.name: heard}, now, bounds)[topic.name]


def topic_document(topic: Topic, now: int) -> dict[str, Any]:
    """As `/status` shows it."""
    counter = topic.counter
    return {
        "pattern": topic.settings.pattern.text,
        "agent": topic.agent,
        "type": topic.settings.type,
        "source": topic.settings.source,
        "matched": topic.matched,
        "asked": topic.quality.text(),
        "offered": [{"node": offer.node, "quality": offer.quality.text()} for offer in topic.offers],
        "problem": topic.problem,
        "incompatible": {"count": counter.incompatible, "policy": topic.incompatible.policy},
        "missed_deadlines": counter.missed_deadlines,
        "lost_liveliness": counter.lost_liveliness,
        "stale": not topic.settings.latched and how_fresh(topic, topic.heard, now) != FRESH,
        "received": counter.received,
        "malformed": counter.malformed,
        "lost": counter.lost,
        "buffer": dict(topic.buffer.counters()),
    }
