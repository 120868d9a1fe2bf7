"""The event detector: live topics -> ring buffers -> rules -> reactions.

One thread (the caller of `turn`) receives, buffers and evaluates the built-in rules, whose time is bounded. Reactions,
recordings, expressions and installed rules have threads and processes of their own and never hold it up. Per message:
one stamp read from the bytes, one buffer insertion, a few counters; fields are decoded only where a rule reads them.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from robotkube.domain.audits import PUSHED_OUT, SUBSCRIPTION, Gap
from robotkube.domain.bridging import GAPS_TOPIC
from robotkube.domain.bridging_properties import read_gap_text
from robotkube.domain.buffers import DUPLICATE, JUMPED, KEPT, BufferPool, Sample
from robotkube.domain.detector_settings import ACTIVE, INACTIVE, PROCESS_BYTES_DEFAULT, TIME_JUMP, DetectorSettings
from robotkube.domain.errors import InputError
from robotkube.domain.layouts import Layouts
from robotkube.domain.messages import string_text
from robotkube.domain.rules import START, STOP, Edge, Message, Question, Rule, RuleEngine, event_identity
from robotkube.services.detector.recording import RecordingReactions
from robotkube.services.detector.topic import Topic
from robotkube.services.detector.topics import DISCOVERY_SECONDS, Place, Topics

if TYPE_CHECKING:
    from robotkube.ports.robots import LiveTopics, TopicInput
    from robotkube.services.detector.raising import Raising
    from robotkube.services.rule_workers import RuleWorkers

DRAIN_MESSAGES_MAX = 500
ADOPT_SECONDS_MAX = 5.0
"""So long nothing is evaluated while the API server has not said which events last already."""

log = logging.getLogger(__name__)

_stamp = itemgetter(2)
_new = tuple.__new__
"""Named tuples without their own constructor, which is a Python function and takes three times as long."""


class Reached(NamedTuple):
    """A state with everything that belongs to it: when it was asked for, and since when it is so, ns since 1970."""

    state: str
    asked: int
    since: int


class EventDetector:
    """Everything of one detector but its threads and its clock."""

    def __init__(
        self,
        sources: Callable[[str], LiveTopics],
        layouts: Layouts,
        raising: Raising,
        recordings: RecordingReactions,
        make_workers: Callable[[], RuleWorkers],
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
    ) -> None:
        self._clock_ns, self._monotonic, self._layouts = clock_ns, monotonic, layouts
        self.pool = BufferPool(PROCESS_BYTES_DEFAULT)
        self.topics = Topics(sources, layouts, clock_ns, self.pool)
        self.raising, self.recordings = raising, recordings
        recordings.buffers = self.pool.buffers
        self._make_workers = make_workers
        self.workers: RuleWorkers | None = None
        self.started = self.applied = clock_ns()
        self.settings = DetectorSettings("", ())
        self.state = INACTIVE
        self.reached = Reached(INACTIVE, self.started, self.started)
        self.engine = RuleEngine((), layouts, "", self._ask)
        self._adopt_until: float | None = None
        self._adopted = True
        self._discover_at = float("-inf")
        self._jumps: deque[Edge] = deque()
        self._gaps: TopicInput | None = None

    @property
    def subscribed(self) -> int:
        """Number of subscriptions."""
        return len(self.topics.topics)

    @property
    def not_ready(self) -> str:
        """Why the detector is not ready, in words; empty when it is."""
        if not self.settings.topics:
            return "not subscribed yet: no settings"
        if self.topics.problems:
            return next(iter(self.topics.problems.values()))
        missing = self.topics.missing() if self.state != INACTIVE else ()
        if missing:
            return f"not subscribed yet: {', '.join(missing)}"
        unreachable = self.raising.unreachable
        return unreachable[0] if unreachable else self.recordings.not_ready

    def apply(self, settings: DetectorSettings, asked: int | None = None) -> None:
        """Take new settings, which came at `asked` (ns since 1970; now when None); buffers, running events and
        unchanged reactions go on."""
        if settings == self.settings:
            return
        before, self.settings = self.settings, settings
        self.applied = self._clock_ns()
        self.pool.limit(settings.buffer_bytes)
        moved = settings.state != self.state and (settings.state != before.state or not before.name)
        was = self._move(settings.state) if moved else self.state
        self.topics.adapt(settings)
        self._subscribe()
        # after the subscriptions: reactions import and connect beside, and that takes time from everything else
        self._apply_reactions(settings)
        self._renew_rules(before, was)
        self._connect(self.topics.topics.values())
        if moved:
            self._moved(asked or self.applied)
        numbers = len(settings.topics), len(settings.rules), len(settings.reactions)
        log.info("settings: topics=%d rules=%d reactions=%d subscriptions=%d", *numbers, self.subscribed)

    def change_state(self, state: str, asked: int | None = None) -> None:
        """Be active, only buffer, or be inactive, until the settings say something else; events that last end.
        `asked`: when it was asked for, ns since 1970; now when None."""
        if state == self.state:
            return
        asked = asked or self._clock_ns()
        was = self._move(state)
        self._subscribe()
        self._renew_rules(self.settings, was)
        self._connect(self.topics.topics.values())
        self._moved(asked)

    def learn(self, type_name: str) -> None:
        """The definition of a type has come that was not known; rules that read it begin."""
        self.topics.learn(type_name)
        self.engine.replace(self.engine.rules, self._clock_ns())
        self._connect(self.topics.topics.values())

    def fill(self, messages: Iterable[tuple[str, str, int, bytes]]) -> int:
        """Fill the buffers: (topic, type, time of reception in ns, message); returns how many were taken in. Also those
        of topics that a pattern would find, and while the detector rests."""
        filled = 0
        places: dict[tuple[str, str], Place | None] = {}
        for name, type_name, received, data in messages:
            if (name, type_name) not in places:
                places[name, type_name] = self.topics.place(name, type_name)
            place = places[name, type_name]
            stamp = None if place is None else self._stamp_of(place, data, received)
            if place is not None and stamp is not None:
                filled += place.buffer.insert(Sample(stamp, received, data)) in (KEPT, JUMPED)
        return filled

    def turn(self) -> int:
        """Receive and evaluate what has arrived; returns the number of messages."""
        now = self._monotonic()
        if now >= self._discover_at:
            self._discover_at = now + DISCOVERY_SECONDS
            self._discover()
        if not self._adopted:
            self._adopt(now)
        evaluating = self.state == ACTIVE and (self._adopted or self._adopt_until is None)
        batch: list[Message] = []
        total = 0
        # each step for all topics before the next one: its code stays in the processor's caches
        arrived = [(topic, topic.input.drain(DRAIN_MESSAGES_MAX)) for topic in self.topics.topics.values()]
        for topic, messages in arrived:
            if messages:
                total += len(messages)
                self._take(topic, messages, batch if evaluating and topic.evaluated else None)
        if evaluating:
            self._evaluate(batch)
        elif self.workers is not None:
            self.workers.collect()  # who rests looks after their processes all the same, and drops what they say
        self._jumps.clear()
        self.recordings.tick(self._clock_ns())
        return total

    def stop(self) -> None:
        """End the processes of rules."""
        if self.workers is not None:
            self.workers.stop()

    def input_document(self) -> dict[str, Any]:
        """`GET /input`."""
        unreadable = self.engine.counts.malformed
        topics = {name: counter.document(unreadable.get(name, 0)) for name, counter in self.topics.counters().items()}
        return {"started": self.started, "now": self._clock_ns(), "topics": topics}

    def events_document(self) -> dict[str, Any]:
        """`GET /events`."""
        return {"started": self.started, "events": self.raising.events_document()}

    # receiving -------------------------------------------------------------------------------------------------------

    def _take(self, topic: Topic, messages: Sequence[tuple[bytes, int]], batch: list[Message] | None) -> None:
        name, type_name, recordings = topic.name, topic.settings.type, topic.recordings
        count, insert, stamp_of = topic.counter.count, topic.buffer.insert, topic.stamp
        lost = topic.counted_before[0] + topic.input.lost
        before = topic.buffer.latest() if lost != topic.counter.lost else None
        for data, received in messages:
            stamp = received
            if stamp_of is not None:
                try:
                    stamp = stamp_of(data) or received  # 0: nobody has set it
                except ValueError:
                    topic.counter.malformed += 1
                    continue
            count(stamp, received)
            sample = _new(Sample, (stamp, received, data))
            outcome = insert(sample)
            if outcome is DUPLICATE:
                continue
            for recording in recordings:
                recording.offer(name, type_name, sample)
            if outcome is JUMPED:
                self._jumped(topic, sample)
            if batch is not None:
                batch.append(_new(Message, (name, type_name, stamp, received, data)))
        if before is not None:
            self._tell_pushed_out(topic, lost - topic.counter.lost, before)
        topic.counter.lost = lost

    @staticmethod
    def _tell_pushed_out(topic: Topic, count: int, before: Sample) -> None:
        """Recordings note what never came here: between what came before and the last of what came now."""
        last = topic.buffer.latest()
        if last is not None and last.stamp - before.stamp > 1:
            gap = Gap(topic.name, SUBSCRIPTION, PUSHED_OUT, count, before.stamp + 1, last.stamp - 1)
            for recording in topic.recordings:
                recording.lack(gap)

    @staticmethod
    def _stamp_of(place: Place, data: bytes, received: int) -> int | None:
        try:
            return received if place.stamp is None else place.stamp(data) or received
        except ValueError:
            place.counter.malformed += 1
            return None

    def _jumped(self, topic: Topic, sample: Sample) -> None:
        """An event of its own: the topic's time has jumped, and its buffer has begun anew."""
        event, trace = event_identity(TIME_JUMP, (topic.agent, topic.name), sample.stamp)
        begin = Edge(TIME_JUMP, START, (topic.agent,), event, trace, sample.received, sample.stamp)
        log.warning("topic %s: its time has jumped to %d; the buffer begins anew", topic.name, sample.stamp)
        self._jumps += (begin, replace(begin, edge=STOP))

    def _evaluate(self, batch: list[Message]) -> None:
        """In the order of the stamps across topics, so that a replay gives the same events."""
        if len(batch) > 1:
            batch.sort(key=_stamp)
        observe = self.engine.observe
        for message in batch:
            for edge in observe(message):
                self._raise(edge)
        if self.workers is not None:
            for verdict in self.workers.collect():
                for edge in self.engine.answer(verdict):
                    self._raise(edge)
        now = self._clock_ns()
        due = self.engine.due()
        if due is not None and due <= now:
            for edge in self.engine.tick(now):
                self._raise(edge)
        while self._jumps:
            self._raise(self._jumps.popleft())

    def _raise(self, edge: Edge) -> None:
        self.recordings.react(edge, self._clock_ns())
        if not self.recordings.only(edge.rule):
            self.raising.react(edge)

    # settings, adoption, subscriptions -------------------------------------------------------------------------------

    def _move(self, state: str) -> str:
        """Go to another state, and give up what it has no use for; the one before."""
        was, self.state = self.state, state
        log.info("state: %s, was %s", state, was)
        if state == INACTIVE:
            self.topics.close_all()
        return was

    def _moved(self, asked: int) -> None:
        self.reached = Reached(self.state, asked, self._clock_ns())

    def _subscribe(self) -> None:
        self.topics.follow(self.state == INACTIVE)
        if self.state != INACTIVE:
            self._connect(self.topics.subscribe_expected())
            self._discover_at = float("-inf")
        self._listen_to_gaps()

    def _apply_reactions(self, settings: DetectorSettings) -> None:
        had_operator = self.raising.operator is not None
        self.raising.apply(settings)
        if self.raising.operator is not None and not had_operator:
            self._adopted, self._adopt_until = False, self._monotonic() + ADOPT_SECONDS_MAX
        self.recordings.apply(settings)
        self._listen_to_gaps()

    def _discover(self) -> None:
        if self.state != INACTIVE:
            self._connect(self.topics.discover())
            self.topics.inspect()
            self.topics.expire()
            self._take_gaps()

    def _listen_to_gaps(self) -> None:
        """Bridges tell what they gave up; recordings note it."""
        wanted = bool(self.settings.recordings) and self.state != INACTIVE
        if wanted and self._gaps is None:
            self._gaps = self.topics.open_gaps()
        elif not wanted and self._gaps is not None:
            self._gaps.close()
            self._gaps = None

    def _take_gaps(self) -> None:
        for data, _ in () if self._gaps is None else self._gaps.drain(DRAIN_MESSAGES_MAX):
            try:
                self.recordings.lack(read_gap_text(string_text(data).decode()))
            except (ValueError, InputError) as error:
                log.warning("topic %s: %s", GAPS_TOPIC, error)

    def _connect(self, topics: Iterable[Topic]) -> None:
        """Tell topics which recordings their messages go to, and whether rules read them."""
        read = [pattern for rule in self.engine.rules for pattern in rule.topics]
        for topic in topics:
            topic.evaluated = any(pattern.agent(topic.name) is not None for pattern in read)
            topic.recordings = self.recordings.of(topic.name)

    def _renew_rules(self, before: DetectorSettings, was: str) -> None:
        """Events of unchanged rules go on; those of another chain, or of a detector that rests, end."""
        now, settings = self._clock_ns(), self.settings
        if any(rule.kind in ("cel", "python") for rule in settings.rules) and self.workers is None:
            self.workers = self._make_workers()
        if settings.name != before.name:
            self._end(self.engine.active, now)
            self.engine = RuleEngine((), self._layouts, settings.agent, self._ask)
        if settings.task != before.task or settings.types != before.types:
            self._replace((), now)
        if self.workers is not None:
            if was == ACTIVE and self.state != ACTIVE:
                self.workers.apply(
                    ()
                )  # what they know goes with the events; new ones are loaded by the time it matters
            self.workers.apply(settings.rules)
        self._replace(settings.rules if self.state == ACTIVE else (), now)

    def _ask(self, question: Question) -> None:
        if self.workers is not None:
            self.workers.ask(question)

    def _replace(self, rules: Sequence[Rule], now: int) -> None:
        _, ended = self.engine.replace(rules, now)
        for edge in ended:
            self._raise(edge)

    def _end(self, edges: Iterable[Edge], now: int) -> None:
        for edge in edges:
            self._raise(replace(edge, edge=STOP, time=now, stamp=now, distance_m=None))

    def _adopt(self, now: float) -> None:
        """Go on with the events that last according to the API server; without its answer begin after a while."""
        operator = self.raising.operator
        if operator is None or operator.adopted is None:
            if self._adopt_until is not None and now >= self._adopt_until:
                self._adopt_until = None
                log.warning("the API server has not said which events last; rules are evaluated from now on")
            return
        self._adopted, self._adopt_until = True, None
        known = {(edge.rule, edge.agents) for edge in self.engine.active}
        for edge in operator.adopted:
            if (edge.rule, edge.agents) not in known:
                self._keep_or_end(edge)

    def _keep_or_end(self, edge: Edge) -> None:
        if self.engine.adopt(edge):
            self.recordings.react(edge, self._clock_ns())
            log.info("event %s: taken over rule=%s agents=%s", edge.id, edge.rule, ",".join(edge.agents))
            return
        log.warning("event %s: no rule %s for %s any more; it ends", edge.id, edge.rule, ",".join(edge.agents))
        self._end((edge,), self._clock_ns())
