"""The subscriptions of a detector: found by patterns while it runs, matched to their publishers, forgotten when silent.

All methods belong to the receiving thread; `topics` may be read by others.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from robotkube.errors import DocumentError
from robotkube.robots.detector.core.liveness import EXPIRED
from robotkube.robots.detector.core.settings import ROS, DetectorSettings, TopicSettings
from robotkube.robots.detector.loops.input_counters import InputCounter
from robotkube.robots.detector.loops.pattern_counters import PatternCounters
from robotkube.robots.detector.loops.subscription import (
    Stamp,
    TopicSubscription,
    of_type,
    problem_of,
    topic_document,
    topic_freshness,
)
from robotkube.robots.mqtt.core.message_properties import GAPS_DEPTH, GAPS_TOPIC, GAPS_TYPE
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.common_messages import STAMPED_TYPES, header_stamp
from robotkube.robots.ros.core.qos import TRANSIENT_LOCAL, PublisherOffer, QosProfile, matching_profile
from robotkube.robots.ros.core.ring_buffers import BufferPool, RingBuffer
from robotkube.robots.ros.core.topic_patterns import TopicPattern
from robotkube.robots.rules.core import Proximity

if TYPE_CHECKING:
    from robotkube.robots.detector.ports import LiveTopics, TopicInput

DISCOVERY_SECONDS = 1.0
SUBSCRIPTIONS_MAX = 1000
COUNTERS_MAX = 2000
INSPECTED_MAX = 50
"""The topics whose publishers are read at once; the others follow the next time."""

log = logging.getLogger(__name__)


class FillTarget(NamedTuple):
    """The buffer, counter and stamp reader of messages that do not come by a subscription."""

    buffer: RingBuffer
    counter: InputCounter
    stamp: Stamp | None


class TopicSubscriptions:
    """The subscriptions of a detector. `sources`: name of a source -> its topics."""

    def __init__(
        self, sources: Callable[[str], LiveTopics], layouts: Layouts, clock_ns: Callable[[], int], pool: BufferPool
    ) -> None:
        self._source = sources
        self._layouts = layouts
        self._clock_ns = clock_ns
        self.pool = pool
        self.topics: dict[str, TopicSubscription] = {}
        self.problems: dict[str, str] = {}
        self._counters: dict[str, InputCounter] = {}
        self._settings = DetectorSettings("", ())
        self._inspected = 0
        self._buffered: dict[str, TopicSettings] = {}
        self.pattern_counters = PatternCounters(self._counter_sources)

    def counters(self) -> Mapping[str, InputCounter]:
        """Topic -> its counter, also of topics that are not subscribed to any more."""
        return dict(self._counters)

    def adapt(self, settings: DetectorSettings) -> None:
        """Apply new settings. A topic whose name and type stay keeps its buffer, within other bounds.

        Its subscription is made anew only when another one is requested. Topics that are not requested any more are
        given up."""
        self._settings = settings
        self.pattern_counters.adapt(topic.pattern.text for topic in settings.topics)
        self.problems.clear()
        for name, before in list(self._buffered.items()):
            chosen = self._chosen(name, before.type, before)
            topic = self.topics.get(name)
            if chosen is None:
                self._forget(name)
            elif chosen != before:
                self._buffer(name, chosen)
                self._counter(name, chosen)
                if topic is not None:
                    self._change(topic, chosen)

    def announce(self, inactive: bool = False) -> None:
        """Announce to the sources the topics that may be subscribed to; none while the detector is inactive."""
        for source in sorted({topic.source for topic in self._settings.topics}):
            wanted = [topic for topic in self._settings.topics if topic.source == source and not inactive]
            self._source(source).announce(wanted)

    def close_all(self) -> None:
        """End every subscription; buffers and counters stay."""
        for topic in self.topics.values():
            topic.close()
        self.topics.clear()

    def subscribe_expected(self) -> list[TopicSubscription]:
        """Subscribe to the topics that are known before they have a publisher; returns the new subscriptions."""
        return self._subscribe(self._expected())

    def is_configured(self, name: str, type_name: str) -> bool:
        """Return whether the settings ask for a topic of this name and type."""
        return self._chosen(name, type_name) is not None

    def place(self, name: str, type_name: str) -> FillTarget | None:
        """The place for messages of that topic that a bag holds; None when the settings ask for no such topic.

        A topic with a buffer is subscribed to with the next discovery, and forgotten when it stays silent."""
        settings = self._buffered.get(name) or self._chosen(name, type_name)
        if settings is None or settings.type != type_name:
            return None
        if name not in self._buffered and len(self._buffered) >= SUBSCRIPTIONS_MAX:
            return None
        return FillTarget(self._buffer(name, settings), self._counter(name, settings), self._stamp(type_name))

    def discover(self) -> list[TopicSubscription]:
        """Subscribe to topics that fit a pattern and have appeared, or have a buffer; returns the new subscriptions."""
        return self._subscribe(self._discovered())

    def open_gaps(self) -> TopicInput:
        """Subscribe to the topic on which bridges of this node report gaps."""
        settings = TopicSettings(TopicPattern(GAPS_TOPIC), GAPS_TYPE, ROS, durability=TRANSIENT_LOCAL, depth=GAPS_DEPTH)
        return self._source(ROS).subscribe(GAPS_TOPIC, settings, QosProfile(durability=TRANSIENT_LOCAL))

    def missing(self) -> list[str]:
        """The topics of the settings that are not subscribed to."""
        expected = {topic.pattern.text for topic in self._settings.topics if not topic.pattern.general}
        return sorted(expected - set(self.topics))

    def inspect(self) -> list[TopicSubscription]:
        """Compare some topics with their publishers; returns those that were subscribed anew, to match them."""
        names = sorted(self.topics)
        chosen = (names + names)[self._inspected : self._inspected + min(INSPECTED_MAX, len(names))]
        self._inspected = (self._inspected + len(chosen)) % len(names) if names else 0
        return [topic for name in chosen if self._inspect_topic(topic := self.topics[name])]

    def expire(self) -> list[TopicSubscription]:
        """Forget topics of patterns that have been silent for too long; returns them.

        A latched topic, whose publishers send once, is forgotten when all topics of its agent have been silent."""
        now = self._clock_ns()
        expected = {name for name, _ in self._expected()}
        last_by_agent: dict[str, int] = {}
        for topic in self.topics.values():
            last_by_agent[topic.agent] = max(last_by_agent.get(topic.agent, 0), topic.last_message_at)
        discovered = [topic for topic in self.topics.values() if topic.name not in expected]
        last = {
            topic.name: last_by_agent[topic.agent] if topic.settings.latched else topic.last_message_at
            for topic in discovered
        }
        gone = [topic for topic in discovered if topic_freshness(topic, last[topic.name], now) == EXPIRED]
        for topic in gone:
            log.info("topic %s: silent for %.0f s; forgotten", topic.name, topic.settings.expire_seconds)
            self._forget(topic.name)
        return gone

    def _forget(self, name: str) -> None:
        topic = self.topics.pop(name, None)
        if topic is not None:
            topic.close()
        self._remove_buffer(name)

    def _remove_buffer(self, name: str) -> None:
        def remove() -> None:
            del self._buffered[name]
            self.pool.remove(name)

        if name in self._buffered:
            self.pattern_counters.forget(self._buffered[name].pattern.text, self.pool.buffers[name], remove)

    def _chosen(self, name: str, type_name: str, before: TopicSettings | None = None) -> TopicSettings | None:
        """The settings of a topic; its own name goes before a pattern, and its settings `before` go before
        everything."""
        fitting = [
            topic
            for topic in self._settings.topics
            if topic.type == type_name and topic.pattern.agent(name) is not None
        ]
        if before in fitting:
            return before
        pattern = before and before.pattern
        return min(fitting, key=lambda topic: (topic.pattern.general, topic.pattern != pattern), default=None)

    def _change(self, topic: TopicSubscription, settings: TopicSettings) -> None:
        before, topic.settings = topic.settings, settings
        topic.agent = settings.pattern.agent(topic.name) or self._settings.agent
        if settings.source != before.source:
            topic.close()
            del self.topics[topic.name]  # to be subscribed to at its new source
        elif (settings.requested_qos, settings.depth) != (before.requested_qos, before.depth):
            source = self._source(settings.source)
            self._subscribe_anew(
                topic, matching_profile(settings.requested_qos, of_type(topic, source.offers(topic.name)))
            )

    def _subscribe_anew(
        self, topic: TopicSubscription, qos: QosProfile, offers: tuple[PublisherOffer, ...] = ()
    ) -> None:
        source = self._source(topic.settings.source)
        refused = topic.counter.incompatible
        former = topic.qos
        fresh = source.subscribe(topic.name, topic.settings, qos, topic.input)
        topic.replace_input(fresh, qos)
        self._report_refusals(topic, refused, former)
        topic.offers = offers
        topic.problem = ""
        log.info("topic %s: subscribed anew as %s", topic.name, qos.text())

    def _expected(self) -> Iterator[tuple[str, TopicSettings]]:
        for settings in self._settings.topics:
            if not settings.pattern.general:
                yield settings.pattern.text, settings
        by_pattern = {settings.pattern: settings for settings in self._settings.topics}
        for rule in self._settings.rules:
            if isinstance(rule.condition, Proximity):
                settings = by_pattern[rule.condition.topic]
                yield from ((settings.pattern.topic(agent), settings) for agent in rule.agents)

    def _discovered(self) -> Iterator[tuple[str, TopicSettings]]:
        yield from list(self._buffered.items())
        general = [settings for settings in self._settings.topics if settings.pattern.general]
        seen = {name: self._source(name).visible() for name in {settings.source for settings in general}}
        for settings in general:
            for name, types in seen[settings.source].items():
                if settings.type in types and settings.pattern.agent(name) is not None:
                    yield name, settings

    def _subscribe(self, wanted: Iterable[tuple[str, TopicSettings]]) -> list[TopicSubscription]:
        new_topics = []
        for name, settings in wanted:
            if name not in self.topics and len(self.topics) < SUBSCRIPTIONS_MAX:
                topic = self._open(name, settings)
                if topic is not None:
                    self.topics[name] = topic
                    new_topics.append(topic)
        return new_topics

    def _open(self, name: str, settings: TopicSettings) -> TopicSubscription | None:
        source = self._source(settings.source)
        qos = matching_profile(
            settings.requested_qos, [offer for offer in source.offers(name) if offer.type == settings.type]
        )
        try:
            subscription = source.subscribe(name, settings, qos)
        except DocumentError as error:
            if self.problems.get(name) != str(error):
                log.error("%s", error)
            self.problems[name] = str(error)
            return None
        self.problems.pop(name, None)
        buffer = self._buffer(name, settings)
        counter = self._counter(name, settings)
        agent = settings.pattern.agent(name) or self._settings.agent
        stamp = self._stamp(settings.type)
        return TopicSubscription(name, agent, settings, subscription, counter, buffer, qos, stamp, self._clock_ns())

    def _buffer(self, name: str, settings: TopicSettings) -> RingBuffer:
        """The topic's buffer, within the bounds of these settings; a new one when its messages are of another type."""
        before = self._buffered.get(name)
        if before is not None and before.type != settings.type:
            self._remove_buffer(name)
        self._buffered[name] = settings
        give = self.pool.change_bounds if name in self.pool.buffers else self.pool.make
        return give(name, settings.bounds, settings.latched, settings.duplicates, settings.jump)

    def _counter(self, name: str, settings: TopicSettings) -> InputCounter:
        """The topic's counter, which goes on when the topic comes back; of those that are gone the oldest is
        forgotten."""
        pattern = settings.pattern.text
        if name not in self._counters and len(self._counters) >= COUNTERS_MAX:
            gone = next((known for known in self._counters if known not in self.topics), "")
            if gone:
                counter = self._counters[gone]
                self.pattern_counters.forget(counter.pattern, counter, partial(self._counters.pop, gone))
        counter = self._counters.setdefault(name, InputCounter(settings.type, pattern))
        counter.type = settings.type
        counter.pattern = pattern
        return counter

    def _counter_sources(self) -> Iterator[tuple[str, InputCounter | RingBuffer]]:
        yield from ((counter.pattern, counter) for counter in list(self._counters.values()))
        yield from self.buffers_by_pattern()

    def buffers_by_pattern(self) -> Iterator[tuple[str, RingBuffer]]:
        """The pattern and buffer of every topic that has one, also while the detector is inactive; any thread."""
        for name, settings in list(self._buffered.items()):
            buffer = self.pool.buffers.get(name)
            if buffer is not None:
                yield settings.pattern.text, buffer

    def _stamp(self, type_name: str) -> Stamp | None:
        """The reader of a type's stamp; None when the type has none, or is not known (yet)."""
        if type_name in STAMPED_TYPES:
            return header_stamp
        try:
            path = self._layouts.stamp_path(type_name)
            reader = self._layouts.reader(type_name, (path,)) if path else None
        except ValueError:
            return None
        return None if reader is None else lambda data: int(reader(data)[0])

    def learn(self, type_name: str) -> None:
        """Learn that a type's definition has come with its messages."""
        for topic in self.topics.values():
            if topic.settings.type == type_name:
                topic.stamp = self._stamp(type_name)

    def _inspect_topic(self, topic: TopicSubscription) -> bool:
        """Compare a topic with its publishers; True when it was subscribed anew.

        It subscribes anew at once when a publisher does not match that could, or when the first ones have come; for a
        stricter profile it waits until the publishers stay the same from one call to the next, since publishers that
        come and go must not cost messages."""
        known = topic.offers
        refused = topic.counter.incompatible
        topic.count()
        offers = tuple(self._source(topic.settings.source).offers(topic.name))
        topic.offers = offers
        self._report_refusals(topic, refused, topic.qos)
        fitting = of_type(topic, offers)
        qos = matching_profile(topic.settings.requested_qos, fitting)
        renewed = bool(fitting) and qos != topic.qos
        if renewed and known and offers != known:
            renewed = len(problem_of(topic, qos)) < len(problem_of(topic, topic.qos))
        if renewed:
            self._subscribe_anew(topic, qos, offers)
        self._report(topic)
        return renewed

    @staticmethod
    def _report(topic: TopicSubscription) -> None:
        """Log the publishers that do not match, and when all match again."""
        problem = problem_of(topic, topic.qos)
        if problem and problem != topic.problem:
            log.warning("topic %s: %s", topic.name, problem)
        elif topic.problem and not problem:
            log.info("topic %s: every publisher fits: asked %s", topic.name, topic.qos.text())
        topic.problem = problem

    @staticmethod
    def _report_refusals(topic: TopicSubscription, refused: int, qos: QosProfile) -> None:
        """Log the publishers that the middleware has refused on its own account; `qos`: the profile at that
        time."""
        if topic.counter.incompatible > refused:
            text = "topic %s: the middleware has refused publishers because of %s (%d so far): asked %s, offered %s"
            offered = (
                "; ".join(dict.fromkeys(offer.qos_profile.text() for offer in topic.offers)) or "not known any more"
            )
            count = topic.counter.incompatible
            policy = topic.incompatible.policy
            log.warning(text, topic.name, policy, count, qos.text(), offered)

    def document(self) -> dict[str, Any]:
        """Every subscription as JSON values, for `/status`."""
        now = self._clock_ns()
        return {topic.name: topic_document(topic, now) for topic in list(self.topics.values())}
