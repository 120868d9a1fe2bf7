"""The subscriptions of a detector: found by patterns while it runs, matched to their publishers, forgotten when silent.

All methods belong to the receiving thread; `topics` may be read by others.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robotkube.domain.bridging import GAPS_DEPTH, GAPS_TOPIC, GAPS_TYPE
from robotkube.domain.buffers import BufferPool, RingBuffer
from robotkube.domain.detector_settings import ROS, DetectorSettings, TopicSettings
from robotkube.domain.errors import DocumentError
from robotkube.domain.freshness import EXPIRED, FRESH, FreshnessBounds, freshness
from robotkube.domain.layouts import Layouts
from robotkube.domain.messages import STAMPED_TYPES, header_stamp
from robotkube.domain.qualities import TRANSIENT_LOCAL, Offer, Quality, matched, mismatch
from robotkube.domain.rules import Proximity
from robotkube.domain.topics import TopicPattern
from robotkube.services.detector.counting import InputCounter

if TYPE_CHECKING:
    from robotkube.ports.robots import LiveTopics, TopicInput
    from robotkube.services.recording.recordings import Recordings

DISCOVERY_SECONDS = 1.0
SUBSCRIPTIONS_MAX, COUNTERS_MAX = 1000, 2000
INSPECTED_MAX = 50
"""So many topics' publishers are looked at in one go; the others the next time."""

Stamp = Callable[[bytes], int]

log = logging.getLogger(__name__)


@dataclass
class Topic:
    """A subscription with everything its messages go to. `problem`: why it cannot be subscribed or does not fit."""

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
    evaluated: bool = False
    recordings: list[Recordings] = field(default_factory=list)


class Topics:
    """Every topic that is subscribed to. `sources`: name of a source -> where its topics are."""

    def __init__(
        self, sources: Callable[[str], LiveTopics], layouts: Layouts, clock_ns: Callable[[], int], pool: BufferPool
    ) -> None:
        self._source, self._layouts, self._clock_ns, self.pool = sources, layouts, clock_ns, pool
        self.topics: dict[str, Topic] = {}
        self.problems: dict[str, str] = {}
        self._counters: dict[str, InputCounter] = {}
        self._settings = DetectorSettings("", ())
        self._inspected = 0

    def counters(self) -> Mapping[str, InputCounter]:
        """Topic -> its counter, also of topics that are not subscribed to any more."""
        return dict(self._counters)

    def close_changed(self, settings: DetectorSettings) -> None:
        """Give up what the settings do not ask for in the same way any more."""
        self._settings = settings
        self.problems.clear()
        for topic in list(self.topics.values()):
            if topic.settings not in settings.topics:
                self._forget(topic)
        for source in sorted({topic.source for topic in settings.topics}):
            self._source(source).follow([topic for topic in settings.topics if topic.source == source])

    def close_all(self) -> None:
        """Give up every subscription; buffers and counters stay."""
        for topic in self.topics.values():
            topic.input.close()
        self.topics.clear()

    def subscribe_expected(self) -> list[Topic]:
        """Subscribe to the topics that are known before anybody publishes them; those that are new."""
        return self._subscribe(self._expected())

    def discover(self) -> list[Topic]:
        """Subscribe to topics that fit a pattern and have appeared; those that are new."""
        return self._subscribe(self._found())

    def open_gaps(self) -> TopicInput:
        """The topic on which bridges of this node tell what they gave up."""
        settings = TopicSettings(TopicPattern(GAPS_TOPIC), GAPS_TYPE, ROS, durability=TRANSIENT_LOCAL, depth=GAPS_DEPTH)
        return self._source(ROS).subscribe(GAPS_TOPIC, settings, Quality(durability=TRANSIENT_LOCAL))

    def missing(self) -> list[str]:
        """Topics of the settings that are not subscribed to."""
        expected = {topic.pattern.text for topic in self._settings.topics if not topic.pattern.general}
        return sorted(expected - set(self.topics))

    def inspect(self) -> list[Topic]:
        """Look at the publishers of some topics; those that were subscribed anew, to fit them."""
        names = sorted(self.topics)
        chosen = (names + names)[self._inspected : self._inspected + min(INSPECTED_MAX, len(names))]
        self._inspected = (self._inspected + len(chosen)) % len(names) if names else 0
        return [topic for name in chosen if self._look_at(topic := self.topics[name])]

    def expire(self) -> list[Topic]:
        """Forget what a pattern found and what has been silent for too long."""
        now = self._clock_ns()
        expected = {name for name, _ in self._expected()}
        silent = [topic for topic in self.topics.values() if topic.name not in expected]
        gone = [topic for topic in silent if _freshness(topic, now) == EXPIRED]
        for topic in gone:
            log.info("topic %s: silent for %.0f s; forgotten", topic.name, topic.settings.expire_seconds)
            self._forget(topic)
        return gone

    def _forget(self, topic: Topic) -> None:
        topic.input.close()
        self.pool.remove(topic.name)
        del self.topics[topic.name]

    def _expected(self) -> Iterator[tuple[str, TopicSettings]]:
        for settings in self._settings.topics:
            if not settings.pattern.general:
                yield settings.pattern.text, settings
        by_pattern = {settings.pattern: settings for settings in self._settings.topics}
        for rule in self._settings.rules:
            if isinstance(rule.condition, Proximity):
                settings = by_pattern[rule.condition.topic]
                yield from ((settings.pattern.topic(agent), settings) for agent in rule.agents)

    def _found(self) -> Iterator[tuple[str, TopicSettings]]:
        general = [settings for settings in self._settings.topics if settings.pattern.general]
        seen = {name: self._source(name).visible() for name in {settings.source for settings in general}}
        for settings in general:
            for name, types in seen[settings.source].items():
                if settings.type in types and settings.pattern.agent(name) is not None:
                    yield name, settings

    def _subscribe(self, wanted: Iterable[tuple[str, TopicSettings]]) -> list[Topic]:
        made = []
        for name, settings in wanted:
            if name not in self.topics and len(self.topics) < SUBSCRIPTIONS_MAX:
                topic = self._open(name, settings)
                if topic is not None:
                    self.topics[name] = topic
                    made.append(topic)
        return made

    def _open(self, name: str, settings: TopicSettings) -> Topic | None:
        source = self._source(settings.source)
        quality = matched(settings.asked, source.offers(name))
        try:
            subscription = source.subscribe(name, settings, quality)
        except DocumentError as error:
            if self.problems.get(name) != str(error):
                log.error("%s", error)
            self.problems[name] = str(error)
            return None
        self.problems.pop(name, None)
        buffer = self.pool.buffers.get(name) or self.pool.make(
            name, settings.bounds, settings.latched, settings.duplicates, settings.jump
        )
        counter = self._counter(name, settings.type)
        agent = settings.pattern.agent(name) or self._settings.agent
        stamp = self._stamp(settings.type)
        return Topic(name, agent, settings, subscription, counter, buffer, quality, stamp, self._clock_ns())

    def _counter(self, name: str, type_name: str) -> InputCounter:
        """The topic's counter goes on when the topic comes back; of those that are gone the oldest is forgotten."""
        if len(self._counters) >= COUNTERS_MAX:
            gone = next((known for known in self._counters if known not in self.topics), None)
            self._counters.pop(gone or "", None)
        return self._counters.setdefault(name, InputCounter(type_name))

    def _stamp(self, type_name: str) -> Stamp | None:
        """How to read a message's stamp; None when the type has none, or nobody knows (yet)."""
        if type_name in STAMPED_TYPES:
            return header_stamp
        try:
            path = self._layouts.stamp_path(type_name)
            reader = self._layouts.reader(type_name, (path,)) if path else None
        except ValueError:
            return None
        return None if reader is None else lambda data: int(reader(data)[0])

    def learn(self, type_name: str) -> None:
        """A type's definition has come with its messages."""
        for topic in self.topics.values():
            if topic.settings.type == type_name:
                topic.stamp = self._stamp(type_name)

    def _look_at(self, topic: Topic) -> bool:
        """Compare a topic with its publishers; True when it was subscribed anew."""
        source = self._source(topic.settings.source)
        offers, topic.matched = tuple(source.offers(topic.name)), topic.input.matched
        if offers == topic.offers:
            return False
        topic.offers = offers
        quality = matched(topic.settings.asked, offers)
        problem = _problem(topic, topic.quality)
        renewed = bool(problem) and quality != topic.quality and len(_problem(topic, quality)) < len(problem)
        if renewed:
            topic.input.close()
            topic.input, topic.quality = source.subscribe(topic.name, topic.settings, quality), quality
            log.info("topic %s: subscribed anew as %s", topic.name, quality.text())
            problem = _problem(topic, quality)
        if problem and problem != topic.problem:
            log.warning("topic %s: %s", topic.name, problem)
        topic.problem = problem
        return renewed

    def document(self) -> dict[str, Any]:
        """Every subscription as JSON values, for `/status`."""
        now = self._clock_ns()
        return {topic.name: _document(topic, now) for topic in list(self.topics.values())}


def _problem(topic: Topic, quality: Quality) -> str:
    found = (mismatch(topic.settings.type, quality, offer) for offer in topic.offers)
    return "; ".join(text for text in found if text)


def _freshness(topic: Topic, now: int) -> str:
    """By when something came last, or the subscription was made."""
    bounds = FreshnessBounds(topic.settings.stale_seconds, topic.settings.expire_seconds)
    return freshness({topic.name: max(topic.counter.newest, topic.since)}, now, bounds)[topic.name]


def _document(topic: Topic, now: int) -> dict[str, Any]:
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
        "stale": not topic.settings.latched and _freshness(topic, now) != FRESH,
        "received": counter.received,
        "malformed": counter.malformed,
        "lost": counter.lost,
        "buffer": dict(topic.buffer.counters()),
    }
