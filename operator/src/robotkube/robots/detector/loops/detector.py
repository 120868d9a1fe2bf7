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
from typing import TYPE_CHECKING, Any, NamedTuple

from robotkube.errors import InputError
from robotkube.robots.detector.core.settings import ACTIVE, INACTIVE, PROCESS_BYTES_DEFAULT, TIME_JUMP, DetectorSettings
from robotkube.robots.detector.loops.recording import RecordingReactions
from robotkube.robots.detector.loops.subscription import TopicSubscription
from robotkube.robots.detector.loops.subscriptions import DISCOVERY_SECONDS, FillTarget, TopicSubscriptions
from robotkube.robots.mqtt.core.message_properties import GAPS_TOPIC, read_gap_text
from robotkube.robots.recording.core.audits import PUSHED_OUT, SUBSCRIPTION
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.common_messages import string_text
from robotkube.robots.ros.core.gaps import Gap
from robotkube.robots.ros.core.ring_buffers import (
    AHEAD,
    DISORDERED,
    DUPLICATE,
    JUMPED,
    KEPT,
    BufferPool,
    Sample,
)
from robotkube.robots.rules.core import (
    START,
    STOP,
    Edge,
    Message,
    Rule,
    RuleEngine,
    RuleQuestion,
    event_identity,
    unseen,
)
from robotkube.robots.rules.core.message_order import MessageOrder

if TYPE_CHECKING:
    from robotkube.robots.detector.loops.dispatching import Dispatcher
    from robotkube.robots.detector.ports import LiveTopics, TopicInput
    from robotkube.robots.rules.loops.workers import RuleWorkers

DRAIN_MESSAGES_MAX = 500
ADOPT_SECONDS_MAX = 5.0
"""The longest wait, without evaluation, for the API server to say which events last already."""

log = logging.getLogger(__name__)

_new = tuple.__new__
"""Named tuples without their own constructor, which is a Python function and takes three times as long."""


class ReachedState(NamedTuple):
    """A state that is reached: when it was asked for, and since when it is so, ns since 1970."""

    state: str
    asked: int
    since: int


class EventDetector:
    """A detector without its threads and its clock: topics, buffers, rules, reactions and recordings."""

    def __init__(
        self,
        sources: Callable[[str], LiveTopics],
        layouts: Layouts,
        dispatcher: Dispatcher,
        recordings: RecordingReactions,
        make_workers: Callable[[], RuleWorkers],
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
    ) -> None:
        self._clock_ns = clock_ns
        self._monotonic = monotonic
        self._layouts = layouts
        self.pool = BufferPool(PROCESS_BYTES_DEFAULT)
        self.topics = TopicSubscriptions(sources, layouts, clock_ns, self.pool)
        self.dispatcher = dispatcher
        self.recordings = recordings
        recordings.buffers = self.pool.buffers
        self._make_workers = make_workers
        self.workers: RuleWorkers | None = None
        self.started = self.applied = clock_ns()
        self.settings = DetectorSettings("", ())
        self.state = INACTIVE
        self.reached = ReachedState(INACTIVE, self.started, self.started)
        self.unseen = unseen.UnseenMessages()
        self.engine = RuleEngine((), layouts, "", self._ask, self.unseen)
        self._order = MessageOrder()
        self._adopt_until: float | None = None
        self._adopted = True
        self._discover_at = float("-inf")
        self._jumps: deque[Edge] = deque()
        self._gaps: TopicInput | None = None

    @property
    def subscribed(self) -> int:
        """The number of subscriptions."""
        return len(self.topics.topics)

    @property
    def wait_ns(self) -> int:
        """How much later than their reception rules look at messages, since some source sends out of order."""
        return self._order.wait_ns

    @property
    def not_ready(self) -> str:
        """The reason why the detector is not ready, in words; empty when it is."""
        if not self.settings.topics:
            return "not subscribed yet: no settings"
        if self.topics.problems:
            return next(iter(self.topics.problems.values()))
        missing = self.topics.missing() if self.state != INACTIVE else ()
        if missing:
            return f"not subscribed yet: {', '.join(missing)}"
        unreachable = self.dispatcher.unreachable
        return unreachable[0] if unreachable else self.recordings.not_ready

    def apply(self, settings: DetectorSettings, asked_at: int | None = None) -> None:
        """Apply new settings, which came at `asked_at` (ns since 1970; now when None).

        Buffers, running events and unchanged reactions go on."""
        if settings == self.settings:
            return
        before = self.settings
        self.settings = settings
        self.applied = self._clock_ns()
        self.pool.limit(settings.buffer_bytes)
        moved = settings.state != self.state and (settings.state != before.state or not before.name)
        former_state = self._move(settings.state) if moved else self.state
        self.topics.adapt(settings)
        self._subscribe()
        # after the subscriptions: reactions import and connect beside, which costs everything else time
        self._apply_reactions(settings)
        self._apply_rules(before, former_state)
        self._connect(self.topics.topics.values())
        if moved:
            self._moved(asked_at or self.applied)
        numbers = len(settings.topics), len(settings.rules), len(settings.reactions)
        log.info("settings: topics=%d rules=%d reactions=%d subscriptions=%d", *numbers, self.subscribed)

    def change_state(self, state: str, asked_at: int | None = None) -> None:
        """Change to active, buffering or inactive, until the settings say something else; events that last end.

        `asked_at`: when it was asked for, ns since 1970; now when None."""
        if state == self.state:
            return
        asked_at = asked_at or self._clock_ns()
        former_state = self._move(state)
        self._subscribe()
        self._apply_rules(self.settings, former_state)
        self._connect(self.topics.topics.values())
        self._moved(asked_at)

    def learn(self, type_name: str) -> None:
        """Learn that the definition of a type has come; rules that read the type begin."""
        self.topics.learn(type_name)
        self.engine.replace(self.engine.rules, self._clock_ns())
        self._connect(self.topics.topics.values())

    def fill(self, messages: Iterable[tuple[str, str, int, bytes]]) -> int:
        """Fill the buffers with (topic, type, time of reception in ns, message); returns the number of inserted
        messages.

        It also fills buffers of topics that a pattern would find, and works while the detector is inactive."""
        filled = 0
        places: dict[tuple[str, str], FillTarget | None] = {}
        for name, type_name, received, data in messages:
            if (name, type_name) not in places:
                places[name, type_name] = self.topics.place(name, type_name)
            place = places[name, type_name]
            stamp = None if place is None else self._stamp_of(place, data, received)
            if place is not None and stamp is not None:
                filled += place.buffer.insert(Sample(stamp, received, data)) in (KEPT, DISORDERED, JUMPED)
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
                self._receive(topic, messages, batch if evaluating and topic.evaluated else None)
        if evaluating:
            self._evaluate(batch)
        elif self.workers is not None:
            self.workers.collect()  # an inactive detector supervises their processes, and drops their answers
        self._jumps.clear()
        self.recordings.tick(self._clock_ns())
        return total

    def settle(self) -> None:
        """Evaluate what waits to be put in order, as if nothing came any more."""
        self._observe(self._order.all())
        for edge in self.engine.settle():
            self._dispatch(edge)

    def stop(self) -> None:
        """End the processes of rules."""
        if self.workers is not None:
            self.workers.stop()

    def input_document(self) -> dict[str, Any]:
        """The document of `GET /input`."""
        unreadable = self.engine.counts.malformed
        topics = {name: counter.document(unreadable.get(name, 0)) for name, counter in self.topics.counters().items()}
        return {"started": self.started, "now": self._clock_ns(), "topics": topics}

    def events_document(self) -> dict[str, Any]:
        """The document of `GET /events`."""
        return {"started": self.started, "events": self.dispatcher.events_document()}

    # receiving -------------------------------------------------------------------------------------------------------

    def _receive(
        self, topic: TopicSubscription, messages: Sequence[tuple[bytes, int]], batch: list[Message] | None
    ) -> None:
        name = topic.name
        type_name = topic.settings.type
        recordings = topic.recordings
        count = topic.counter.count
        insert = topic.buffer.insert
        stamp_of = topic.stamp
        lost = topic.counted_before[0] + topic.input.lost
        before = topic.buffer.latest() if lost != topic.counter.lost else None
        for data, received in messages:
            stamp = received
            if stamp_of is not None:
                try:
                    stamp = stamp_of(data) or received  # 0: nobody has set it
                except ValueError:
                    topic.counter.malformed += 1
                    if topic.evaluated:
                        self.unseen.count(name, unseen.MALFORMED)
                    continue
            count(stamp, received)
            sample = _new(Sample, (stamp, received, data))
            outcome = insert(sample)
            if outcome is not KEPT and not self._goes_on(topic, sample, outcome, batch):
                continue
            for recording in recordings:
                recording.offer(name, type_name, sample)
            if batch is not None:
                batch.append(_new(Message, (name, type_name, stamp, received, data)))
        if before is not None:
            self._note_pushed_out(topic, lost - topic.counter.lost, before)
        topic.counter.lost = lost
        if topic.evaluated:
            self._count_unseen(topic, 0 if batch is not None else len(messages))

    def _count_unseen(self, topic: TopicSubscription, unevaluated: int) -> None:
        """Count messages that rules have not got: those that were pushed out, and `unevaluated` ones."""
        if topic.counter.lost > topic.lost_unseen:
            self.unseen.count(topic.name, unseen.LOST, topic.counter.lost - topic.lost_unseen)
            topic.lost_unseen = topic.counter.lost
        if unevaluated and self.state == ACTIVE:
            self.unseen.count(topic.name, unseen.STARTING, unevaluated)

    def _goes_on(self, topic: TopicSubscription, sample: Sample, outcome: str, batch: list[Message] | None) -> bool:
        """Return whether a message that is not simply the next one goes on to recordings and rules."""
        if outcome is DUPLICATE:
            return False
        if outcome is JUMPED:
            self._jumped(topic, sample, batch)
            return True
        if outcome is DISORDERED:
            if batch is not None:
                self._order.note_disorder(topic.name, topic.buffer.clock, sample.received)
            return True
        for recording in topic.recordings:
            if outcome is not AHEAD or recording.plan.always:  # nobody knows to which event it belongs
                recording.offer(topic.name, topic.settings.type, sample)
        if batch is not None:
            self.unseen.count(topic.name, outcome)
            self.engine.overlook(topic.name, sample.received)
        return False

    @staticmethod
    def _note_pushed_out(topic: TopicSubscription, count: int, before: Sample) -> None:
        """Report to recordings the messages that were pushed out: between the message before and the last of these."""
        last = topic.buffer.latest()
        if last is not None and last.stamp - before.stamp > 1:
            gap = Gap(topic.name, SUBSCRIPTION, PUSHED_OUT, count, before.stamp + 1, last.stamp - 1)
            for recording in topic.recordings:
                recording.note_gap(gap)

    @staticmethod
    def _stamp_of(place: FillTarget, data: bytes, received: int) -> int | None:
        try:
            return received if place.stamp is None else place.stamp(data) or received
        except ValueError:
            place.counter.malformed += 1
            return None

    def _jumped(self, topic: TopicSubscription, sample: Sample, batch: list[Message] | None) -> None:
        """Queue an event of the rule time-jump: the topic's time has jumped, and its buffer has begun anew.

        Rules get what came from it before the jump first, and begin anew with the topic as its buffer does."""
        if batch is not None:
            self._observe(self._order.of(topic.name, batch, self._clock_ns()))
            self.engine.restart(topic.name, sample.stamp)
        event, trace = event_identity(TIME_JUMP, (topic.agent, topic.name), sample.stamp)
        begin = Edge(TIME_JUMP, START, (topic.agent,), event, trace, sample.received, sample.stamp)
        log.warning("topic %s: its time has jumped to %d; the buffer begins anew", topic.name, sample.stamp)
        self._jumps += (begin, replace(begin, edge=STOP))

    def _evaluate(self, batch: list[Message]) -> None:
        """Evaluate messages in the order of their stamps across topics, so that a replay gives the same events."""
        now = self._clock_ns()
        self._observe(self._order.due(batch, now))
        if self.workers is not None:
            for answered in self.workers.collect():
                for edge in self.engine.answer(answered):
                    self._dispatch(edge)
        moment = self._clock_ns() - self._order.wait_ns
        due = self.engine.due()
        if due is not None and due <= moment:
            for edge in self.engine.tick(moment):
                self._dispatch(edge)
        while self._jumps:
            self._dispatch(self._jumps.popleft())

    def _observe(self, messages: Iterable[Message]) -> None:
        observe = self.engine.observe
        for message in messages:
            for edge in observe(message):
                self._dispatch(edge)

    def _dispatch(self, edge: Edge) -> None:
        self.recordings.react(edge, self._clock_ns())
        if not self.recordings.only(edge.rule):
            self.dispatcher.react(edge)

    # settings, adoption, subscriptions -------------------------------------------------------------------------------

    def _move(self, state: str) -> str:
        """Change to a state and close the subscriptions that it does not need; returns the state before."""
        former_state = self.state
        self.state = state
        log.info("state: %s, was %s", state, former_state)
        if state == INACTIVE:
            self.topics.close_all()
        return former_state

    def _moved(self, asked_at: int) -> None:
        self.reached = ReachedState(self.state, asked_at, self._clock_ns())

    def _subscribe(self) -> None:
        self.topics.announce(self.state == INACTIVE)
        if self.state != INACTIVE:
            self._connect(self.topics.subscribe_expected())
            self._discover_at = float("-inf")
        self._listen_to_gaps()

    def _apply_reactions(self, settings: DetectorSettings) -> None:
        had_operator = self.dispatcher.operator is not None
        self.dispatcher.apply(settings)
        if self.dispatcher.operator is not None and not had_operator:
            self._adopted = False
            self._adopt_until = self._monotonic() + ADOPT_SECONDS_MAX
        self.recordings.apply(settings)
        self._listen_to_gaps()

    def _discover(self) -> None:
        if self.state != INACTIVE:
            self._connect(self.topics.discover())
            self.topics.inspect()
            self.topics.expire()
            self._receive_gaps()

    def _listen_to_gaps(self) -> None:
        """Subscribe to the gaps that bridges report while there are recordings, which note them."""
        wanted = bool(self.settings.recordings) and self.state != INACTIVE
        if wanted and self._gaps is None:
            self._gaps = self.topics.open_gaps()
        elif not wanted and self._gaps is not None:
            self._gaps.close()
            self._gaps = None

    def _receive_gaps(self) -> None:
        for data, _ in () if self._gaps is None else self._gaps.drain(DRAIN_MESSAGES_MAX):
            try:
                self.recordings.note_gap(read_gap_text(string_text(data).decode()))
            except (ValueError, InputError) as error:
                log.warning("topic %s: %s", GAPS_TOPIC, error)

    def _connect(self, topics: Iterable[TopicSubscription]) -> None:
        """Set for topics which recordings their messages go to, and whether rules read them."""
        patterns = [pattern for rule in self.engine.rules for pattern in rule.topics]
        for topic in topics:
            topic.evaluated = any(pattern.agent(topic.name) is not None for pattern in patterns)
            topic.recordings = self.recordings.of(topic.name)

    def _apply_rules(self, before: DetectorSettings, former_state: str) -> None:
        """Apply the settings' rules. Events of unchanged ones go on; those of another chain, or of an inactive
        detector, end."""
        now = self._clock_ns()
        settings = self.settings
        self.settle()  # by the rules that were there when it came
        if any(rule.kind in ("cel", "python") for rule in settings.rules) and self.workers is None:
            self.workers = self._make_workers()
        if settings.name != before.name:
            self._end(self.engine.active, now)
            self.engine = RuleEngine((), self._layouts, settings.agent, self._ask, self.unseen)
        if settings.task != before.task or settings.types != before.types:
            self._replace((), now)
        if self.workers is not None:
            if former_state == ACTIVE and self.state != ACTIVE:
                self.workers.apply(())  # their state ends with the events; new processes are loaded by the time needed
            self.workers.apply(settings.rules)
        self._replace(settings.rules if self.state == ACTIVE else (), now)

    def _ask(self, question: RuleQuestion) -> None:
        if self.workers is not None:
            self.workers.ask(question)

    def _replace(self, rules: Sequence[Rule], now: int) -> None:
        _, ended = self.engine.replace(rules, now)
        for edge in ended:
            self._dispatch(edge)

    def _end(self, edges: Iterable[Edge], now: int) -> None:
        for edge in edges:
            self._dispatch(replace(edge, edge=STOP, time=now, stamp=now, distance_m=None))

    def _adopt(self, now: float) -> None:
        """Take over the events that last according to the API server; without its answer evaluation begins after a
        while."""
        operator = self.dispatcher.operator
        if operator is None or operator.adopted is None:
            if self._adopt_until is not None and now >= self._adopt_until:
                self._adopt_until = None
                log.warning("the API server has not said which events last; rules are evaluated from now on")
            return
        self._adopted = True
        self._adopt_until = None
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
