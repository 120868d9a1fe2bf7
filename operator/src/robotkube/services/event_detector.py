"""The event detector: live topics -> ring buffers -> rules -> reactions.

One thread (the caller of `turn`) receives and evaluates. Reactions have threads of their own and never hold it up.
Per message: one stamp read from the bytes, three counters, one buffer append; fields are decoded only for topics
that a rule reads.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from robotkube.domain.buffers import BufferBounds, RingBuffer, Sample
from robotkube.domain.detection import STOP, Always, Edge, RuleState, rule_state
from robotkube.domain.detector_settings import (
    AlwaysRule,
    DetectorSettings,
    ProximityRule,
    RecordingReaction,
    TopicSettings,
)
from robotkube.domain.errors import DocumentError
from robotkube.domain.messages import STAMPED_TYPES, header_stamp
from robotkube.services.operator_reactions import EventRecord, OperatorReactions
from robotkube.services.recording.recordings import Recordings

if TYPE_CHECKING:
    from robotkube.ports.robots import LiveTopics, TopicInput

DISCOVERY_SECONDS = 1.0
DRAIN_MESSAGES_MAX = 500
EVENTS_MAX = 1000
SECONDS_KEPT = 1800
AGE_MS_MAX = 1000
BUFFER_MESSAGES_MAX = 100_000
SUBSCRIPTIONS_MAX = 1000

log = logging.getLogger(__name__)


class InputCounter:
    """What arrived on one topic, as /input shows it. Written by the receiving thread, read by others without a lock."""

    __slots__ = ("_ages", "_second", "_seconds", "malformed", "received", "type")

    def __init__(self, type_name: str) -> None:
        self.type, self.received, self.malformed = type_name, 0, 0
        self._seconds: deque[list[int]] = deque(maxlen=SECONDS_KEPT)
        self._second: list[int] = [0, 0]
        self._ages = [0] * (AGE_MS_MAX + 1)

    def count(self, stamp: int, received: int) -> None:
        """One message measured at `stamp` and received at `received` (ns)."""
        self.received += 1
        second = received // 1_000_000_000
        if second != self._second[0]:
            self._second = [second, 0]
            self._seconds.append(self._second)
        self._second[1] += 1
        age = (received - stamp) // 1_000_000
        self._ages[0 if age < 0 else age if age < AGE_MS_MAX else AGE_MS_MAX] += 1

    def document(self, dropped: int) -> dict[str, Any]:
        """The counter as JSON values."""
        return {
            "type": self.type,
            "received": self.received,
            "dropped": dropped,
            "malformed": self.malformed,
            "seconds": [list(pair) for pair in list(self._seconds)],
            "ages_ms": [[age, count] for age, count in enumerate(self._ages) if count],
        }


@dataclass
class _Topic:
    """A subscription with everything its messages go to."""

    name: str
    settings: TopicSettings
    input: TopicInput
    counter: InputCounter
    buffer: RingBuffer
    stamped: bool
    rules: list[tuple[RuleState, str]] = field(default_factory=list)
    recordings: list[Recordings] = field(default_factory=list)


class EventDetector:
    """Everything of one detector but its threads and its clock.

    `make_operator` and `make_recordings` give started reactions; they are called when settings ask for them, after the
    subscriptions are made.
    """

    def __init__(
        self,
        live: LiveTopics,
        make_operator: Callable[[DetectorSettings], OperatorReactions],
        make_recordings: Callable[[RecordingReaction, DetectorSettings], Recordings],
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
    ) -> None:
        self._live, self._make_operator, self._make_recordings = live, make_operator, make_recordings
        self._operator: OperatorReactions | None = None
        self._clock_ns, self._monotonic = clock_ns, monotonic
        self.started = clock_ns()
        self._settings = DetectorSettings("", ())
        self._topics: dict[str, _Topic] = {}
        self._rules: dict[str, RuleState] = {}
        self._recordings: dict[str, tuple[RecordingReaction, Recordings]] = {}
        self._events: deque[EventRecord] = deque(maxlen=EVENTS_MAX)
        self._discovered_at = float("-inf")
        self._adopted = True
        self.problem = ""

    @property
    def recordings(self) -> tuple[Recordings, ...]:
        """The recording reactions at work."""
        return tuple(recordings for _, recordings in self._recordings.values())

    @property
    def after_seconds(self) -> float:
        """How long the recordings go on once the process is asked to end."""
        return max((recordings.plan.after_seconds for recordings in self.recordings), default=0.0)

    @property
    def subscribed(self) -> int:
        """Number of subscriptions."""
        return len(self._topics)

    @property
    def not_ready(self) -> str:
        """Why the detector is not ready, in words; empty when it is."""
        if self.problem:
            return self.problem
        expected = {topic.pattern.text for topic in self._settings.topics if not topic.pattern.general}
        missing = sorted(expected - set(self._topics))
        if not self._settings.topics or missing:
            return f"not subscribed yet: {', '.join(missing) or 'no settings'}"
        if self._operator is not None and not self._operator.reachable:
            return "the API server has not answered yet"
        waiting = [recordings.plan.recording for recordings in self.recordings if not recordings.ready]
        return f"database or claim has not answered yet: {', '.join(waiting)}" if waiting else ""

    def apply(self, settings: DetectorSettings) -> list[Recordings]:
        """Take new settings; running events and unchanged recordings go on. Returns recordings that the caller ends."""
        if settings == self._settings:
            return []
        before, self._settings = self._settings, settings
        self.problem = ""
        if self._operator is not None:
            self._operator.parent = settings.task
        self._close_topics(settings)
        self._renew_rules(before)
        self._subscribe(self._expected())
        # after the subscriptions: reactions import and connect beside, and that takes time from everything else
        if settings.operators and self._operator is None:
            self._operator, self._adopted = self._make_operator(settings), False
        ended = self._renew_recordings()
        for topic in self._topics.values():
            self._connect(topic)
        numbers = len(settings.topics), len(settings.rules), len(settings.reactions)
        log.info("settings: topics=%d rules=%d reactions=%d subscriptions=%d", *numbers, len(self._topics))
        return ended

    def turn(self) -> int:
        """Receive and evaluate what has arrived; returns the number of messages."""
        if self._monotonic() - self._discovered_at >= DISCOVERY_SECONDS:
            self._discover()
        if not self._adopted:
            self._adopt()
        if self._adopted:
            self._begin()
        total = 0
        for topic in list(self._topics.values()):
            messages = topic.input.drain(DRAIN_MESSAGES_MAX)
            for data, received in messages:
                self._take(topic, data, received)
            total += len(messages)
        return total

    def input_document(self) -> dict[str, Any]:
        """`GET /input`."""
        topics = {name: topic.counter.document(topic.input.lost) for name, topic in list(self._topics.items())}
        return {"started": self.started, "now": self._clock_ns(), "topics": topics}

    def events_document(self) -> dict[str, Any]:
        """`GET /events`."""
        return {"started": self.started, "events": [record.document() for record in list(self._events)]}

    # receiving -------------------------------------------------------------------------------------------------------

    def _take(self, topic: _Topic, data: bytes, received: int) -> None:
        stamp = received
        if topic.stamped:
            try:
                stamp = header_stamp(data)
            except ValueError:
                topic.counter.malformed += 1
                return
        topic.counter.count(stamp, received)
        sample = Sample(stamp, received, data)
        topic.buffer.insert(sample)
        for recordings in topic.recordings:
            recordings.offer(topic.name, topic.settings.type, sample)
        if topic.rules and self._adopted:
            self._evaluate(topic, data, stamp, received)

    def _evaluate(self, topic: _Topic, data: bytes, stamp: int, received: int) -> None:
        for state, agent in topic.rules:
            try:
                edges = state.evaluate(agent, data, stamp, received)
            except ValueError:
                topic.counter.malformed += 1
                return
            for edge in edges:
                self._raise(edge, state.reason)

    def _begin(self) -> None:
        """Raise the events of rules that always hold and somebody reacts to by a task."""
        asked = {reaction.rule for reaction in self._settings.operators}
        for name, state in self._rules.items():
            if isinstance(state, Always) and name in asked:
                for edge in state.begin(self._clock_ns()):
                    self._raise(edge, state.reason)

    def _raise(self, edge: Edge, reason: str = "") -> None:
        record = EventRecord(edge)
        self._events.append(record)
        log.info(
            "event %s: %s raised rule=%s agents=%s distance_m=%s stamp=%d time=%d",
            edge.id, edge.edge, edge.rule, ",".join(edge.agents), edge.distance_m, edge.stamp, edge.time,
        )  # fmt: skip
        reaction = next((r for r in self._settings.operators if r.rule == edge.rule), None)
        if self._operator is not None and (reaction is not None or edge.edge == STOP):
            self._operator.react(record, reaction, reason)

    def _adopt(self) -> None:
        assert self._operator is not None
        if self._operator.adopted is None:
            return
        self._adopted = True
        for edge in self._operator.adopted:
            self._keep_or_end(edge)

    def _keep_or_end(self, edge: Edge) -> None:
        state = self._rules.get(edge.rule)
        if state is not None and state.adopt(edge):
            log.info("event %s: taken over rule=%s agents=%s", edge.id, edge.rule, ",".join(edge.agents))
            return
        log.warning("event %s: no rule %s for %s any more; it ends", edge.id, edge.rule, ",".join(edge.agents))
        self._end(edge)

    def _end(self, edge: Edge) -> None:
        now = self._clock_ns()
        self._raise(replace(edge, edge=STOP, time=now, stamp=now, distance_m=None))

    # settings and subscriptions --------------------------------------------------------------------------------------

    def _close_topics(self, settings: DetectorSettings) -> None:
        for name, topic in list(self._topics.items()):
            if topic.settings not in settings.topics:
                topic.input.close()
                del self._topics[name]

    def _renew_rules(self, before: DetectorSettings) -> None:
        running = [edge for state in self._rules.values() for edge in state.active]
        types, types_before = (
            {topic.pattern.text: topic.type for topic in settings.topics} for settings in (self._settings, before)
        )
        same_chain = self._settings.task == before.task
        same = same_chain and types == types_before
        unchanged = {rule for rule in self._settings.rules if rule in before.rules and same}
        self._rules = {
            rule.name: self._rules[rule.name] if rule in unchanged else rule_state(rule, types, self._settings.agent)
            for rule in self._settings.rules
        }
        kept = {edge for state in self._rules.values() for edge in state.active}
        for edge in running:
            if edge not in kept:
                self._keep_or_end(edge) if same_chain else self._end(edge)

    def _renew_recordings(self) -> list[Recordings]:
        wanted = {reaction.recording: reaction for reaction in self._settings.recordings}
        ended = [
            recordings for name, (reaction, recordings) in self._recordings.items() if wanted.get(name) != reaction
        ]
        self._recordings = {name: pair for name, pair in self._recordings.items() if pair[1] not in ended}
        for name, reaction in wanted.items():
            if name not in self._recordings:
                self._recordings[name] = reaction, self._make_recordings(reaction, self._settings)
        return ended

    def _expected(self) -> Iterator[tuple[str, TopicSettings]]:
        """Topics that are known before anybody publishes them."""
        for settings in self._settings.topics:
            if not settings.pattern.general:
                yield settings.pattern.text, settings
        for rule in self._settings.rules:
            if isinstance(rule, ProximityRule):
                settings = next(s for s in self._settings.topics if s.pattern == rule.topic)
                yield from ((settings.pattern.topic(agent), settings) for agent in rule.agents)

    def _discover(self) -> None:
        """Look for topics that fit a pattern and are not subscribed yet."""
        self._discovered_at = self._monotonic()
        general = [settings for settings in self._settings.topics if settings.pattern.general]
        if not general:
            return
        found = [
            (name, settings)
            for name, types in self._live.visible().items()
            for settings in general
            if settings.type in types and settings.pattern.agent(name) is not None
        ]
        self._subscribe(iter(found))

    def _subscribe(self, wanted: Iterator[tuple[str, TopicSettings]]) -> None:
        for name, settings in wanted:
            if name in self._topics or len(self._topics) >= SUBSCRIPTIONS_MAX:
                continue
            try:
                source = self._live.subscribe(name, settings)
            except DocumentError as error:
                self.problem = str(error)
                log.error("%s", error)
                continue
            count_max = settings.depth if settings.latched else BUFFER_MESSAGES_MAX
            bounds = BufferBounds(settings.buffer_seconds, settings.buffer_bytes, count_max)
            buffer = RingBuffer(bounds, settings.latched)
            stamped = settings.type in STAMPED_TYPES
            topic = _Topic(name, settings, source, InputCounter(settings.type), buffer, stamped)
            self._connect(topic)
            self._topics[name] = topic

    def _connect(self, topic: _Topic) -> None:
        """Tell the topic which rules and recorders its messages go to."""
        pattern, agent = topic.settings.pattern, topic.settings.pattern.agent(topic.name)
        topic.rules = [
            (state, agent or self._settings.agent)
            for state in self._rules.values()
            if not isinstance(state.rule, AlwaysRule) and state.rule.topic == pattern
            if not isinstance(state.rule, ProximityRule) or agent in state.rule.agents
        ]
        topic.recordings = [
            recordings for recordings in self.recordings if recordings.plan.topic(topic.name) is not None
        ]
