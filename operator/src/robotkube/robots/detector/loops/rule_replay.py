"""Replay of bags through rules: the detector itself, fed from bags instead of the network and driven by their clock.

It runs EventDetector as in a vehicle, with the same buffers, stamps and rules; only the source of the messages, the
clock and the receiver of the events are different. It waits for rules in processes of their own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NoReturn

from robotkube.errors import InputError
from robotkube.robots.detector.core.settings import ACTIVE, DetectorSettings, TopicSettings
from robotkube.robots.detector.loops.detector import EventDetector
from robotkube.robots.detector.loops.dispatching import Dispatcher
from robotkube.robots.detector.loops.recording import RecordingReactions
from robotkube.robots.detector.loops.status import apart_documents
from robotkube.robots.detector.loops.subscription import TopicSubscription
from robotkube.robots.detector.loops.subscriptions import SUBSCRIPTIONS_MAX
from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile, QosViolations
from robotkube.robots.rules.core import AnsweredQuestion, Edge
from robotkube.robots.rules.core.unseen import unseen_text
from robotkube.robots.rules.loops.workers import RuleWorkers

if TYPE_CHECKING:
    from robotkube.robots.detector.ports import TopicInput

CLOCKS_APART_NS = 60_000_000_000
"""The distance from the bags' times beyond which stamps are of another clock: simulated time, or a bag of a bag."""
CLOCK_MESSAGES = 20
"""The messages of each topic that are compared for that."""
TURN_NS = 10_000_000
"""The span of messages that are given at once, as they come from a network."""
PAUSE_NS = 2_000_000_000
PAUSE_TURNS_NS = (1_200_000_000, 150_000_000)
"""After a pause of the first, the detector discovers topics at the second before the next message, as it would live:
expired topics are forgotten, and found again, before it comes."""
EDGES_MAX = 1_000_000
TURNS_MAX = 100_000

BagMessages = Iterable[tuple[str, int, bytes]]


@dataclass
class BagInput:
    """A subscription to a topic of bags (port TopicInput)."""

    waiting: deque[tuple[bytes, int]] = field(default_factory=deque)
    lost: int = 0
    closed: bool = False
    matched: int = 1
    incompatible: IncompatiblePublishers = field(default_factory=IncompatiblePublishers)
    violations: QosViolations = field(default_factory=QosViolations)

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """See the port."""
        if len(self.waiting) <= messages_max:
            messages = list(self.waiting)
            self.waiting.clear()
            return messages
        return [self.waiting.popleft() for _ in range(messages_max)]

    def close(self) -> None:
        """See the port. Messages that wait are kept until the topic is found again."""
        self.closed = True


class BagTopics:
    """Topics of bags as inputs of a detector (port LiveTopics). `types`: topic -> its type."""

    def __init__(self, types: Mapping[str, str]) -> None:
        self._types = types
        self.inputs: dict[str, BagInput] = {}

    def announce(self, topics: Sequence[TopicSettings]) -> None:
        """See the port."""

    def subscribe(
        self, topic: str, settings: TopicSettings, qos: QosProfile, before: TopicInput | None = None
    ) -> BagInput:
        """See the port."""
        topic_input = self.inputs.setdefault(topic, BagInput())
        topic_input.closed = False
        return topic_input

    def visible(self) -> Mapping[str, Sequence[str]]:
        """See the port."""
        return {name: (type_name,) for name, type_name in self._types.items()}

    def offers(self, topic: str) -> Sequence[PublisherOffer]:
        """See the port."""
        return ()

    def put(self, topic: str, data: bytes, time: int) -> None:
        """A message of the bags waits for its subscription; one of a topic without any is nobody's."""
        topic_input = self.inputs.get(topic)
        if topic_input is not None:
            topic_input.waiting.append((data, time))

    @property
    def waiting(self) -> bool:
        """Return whether subscriptions have messages that were not drained."""
        return any(topic_input.waiting and not topic_input.closed for topic_input in self.inputs.values())


class PatientWorkers(RuleWorkers):
    """Processes of rules that wait for every answer, since a replay is faster than they are."""

    _settling = False

    def collect(self) -> list[AnsweredQuestion]:
        """The answers to all questions so far."""
        if self._settling:
            return super().collect()
        self._settling = True
        try:
            return self.settle()
        finally:
            self._settling = False


class _EdgeCollector(Dispatcher):
    """A dispatcher that collects the edges and has no reactions."""

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        super().__init__(_refuse, _refuse, clock_ns)
        self.edges: list[Edge] = []

    def react(self, edge: Edge) -> None:
        """Collect an edge; InputError beyond EDGES_MAX."""
        if len(self.edges) >= EDGES_MAX:
            raise InputError(f"the rules give more than {EDGES_MAX} edges; give them cooldown_seconds or hysteresis")
        self.edges.append(edge)


def _refuse(*_: object) -> NoReturn:
    raise AssertionError("a replay has no reactions")


@dataclass
class ReplayResult:
    """The result of a replay. `first`, `last`: times of the bags in ns, 0 without a message; `begin`: `first` on the
    clock of the messages' stamps; `messages`: number of messages of topics that rules read; `unseen`: topic -> reason
    -> messages that a rule did not see; `apart`: pairs that rules did not compare, as `/status` has them; `incomplete`:
    rules that could not read all messages, and why; `problems`: other remarks on the result."""

    edges: list[Edge] = field(default_factory=list)
    messages: int = 0
    first: int = 0
    begin: int = 0
    last: int = 0
    unseen: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    apart: Sequence[Mapping[str, Any]] = ()
    incomplete: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def topics_read(settings: DetectorSettings, types: Mapping[str, str]) -> Collection[str]:
    """The topics of the bags that rules read."""
    patterns = {pattern for rule in settings.rules for pattern in rule.topics}
    by_pattern = {topic.pattern: topic.type for topic in settings.topics}
    return {
        name
        for name, type_name in types.items()
        if any(pattern.agent(name) is not None and by_pattern.get(pattern) == type_name for pattern in patterns)
    }


@dataclass
class _Clock:
    """The lag of the messages' stamps behind the bags' times; `seen`: topic -> messages compared."""

    seen: dict[str, int] = field(default_factory=dict)
    _least: int | None = None

    def observe(self, topic: TopicSubscription | None, name: str, data: bytes, time: int) -> None:
        """Compare one of a topic's first messages with its time in the bag."""
        self.seen[name] = self.seen.get(name, 0) + 1
        try:
            stamp = topic.stamp(data) if topic is not None and topic.stamp is not None else 0
        except ValueError:
            return
        if stamp and (self._least is None or abs(time - stamp) < abs(self._least)):
            self._least = time - stamp

    @property
    def lag(self) -> int:
        """The lag in ns; 0 when it is the same clock."""
        return self._least if self._least is not None and abs(self._least) > CLOCKS_APART_NS else 0

    def problems(self, begin: int) -> Iterable[str]:
        """The remark on another clock, if there is one."""
        if self.lag:
            way = "behind" if self.lag > 0 else "ahead of"
            yield (
                f"the messages' stamps are {abs(self.lag) / 1e9:.0f} s {way} the bags' times: another clock; "
                f"seconds are counted from the stamp {begin}, which the first message has by it"
            )


def replay(
    settings: DetectorSettings,
    layouts: Layouts,
    types: Mapping[str, str],
    messages: BagMessages,
    make_workers: Callable[[], RuleWorkers],
    turn_ns: int = TURN_NS,
) -> ReplayResult:
    """Play `messages` (topic, time, bytes; times ascending) through a detector with these settings, as fast as it goes.

    `types`: topic -> type of what is in the bags. InputError when there are more than EDGES_MAX edges."""
    result = ReplayResult()
    clock = _Clock()
    now = begin = 0

    def clock_ns() -> int:
        return now

    source = BagTopics(types)
    collector = _EdgeCollector(clock_ns)
    detector = EventDetector(
        lambda _: source, layouts, collector, RecordingReactions(_refuse), make_workers, clock_ns, lambda: now / 1e9
    )
    try:
        for name, time, data in messages:
            if not result.messages:
                result.first = now = begin = time
                detector.apply(replace(settings, reactions=(), task="", bag="", state=ACTIVE))
                detector.turn()  # subscribes to what patterns find
            elif time > begin + turn_ns:
                _turns(detector, source)
                for before in PAUSE_TURNS_NS if time - now > PAUSE_NS else ():
                    now = time - before
                    detector.turn()
                begin = time
            result.messages += 1
            now = result.last = max(now, time)
            source.put(name, data, time)
            if clock.seen.get(name, 0) < CLOCK_MESSAGES:
                clock.observe(detector.topics.topics.get(name), name, data, time)
        if result.messages:
            _turns(detector, source)
            detector.settle()
            _turns(detector, source)  # what processes answered to the last messages
        result.edges = sorted(collector.edges, key=lambda edge: edge.stamp)
        _judge(result, detector, clock, source)
    finally:
        detector.stop()
    return result


def _judge(result: ReplayResult, detector: EventDetector, clock: _Clock, source: BagTopics) -> None:
    """Write into the result what rules did not see, did not compare and could not read, and other remarks."""
    result.unseen = detector.unseen.topics()
    result.apart = apart_documents(detector.engine)
    result.incomplete = list(_incomplete_rules(detector))
    result.begin = result.first - clock.lag
    result.problems = [*clock.problems(result.begin), *_unseen_problems(result)]
    result.problems += [
        f"{name}: not read: {SUBSCRIPTIONS_MAX} topics are" for name in sorted(set(clock.seen) - set(source.inputs))
    ]


def _turns(detector: EventDetector, source: BagTopics) -> None:
    for _ in range(TURNS_MAX):
        detector.turn()
        if not source.waiting:
            return


def _unseen_problems(result: ReplayResult) -> Iterable[str]:
    for topic, counts in sorted(result.unseen.items()):
        yield f"{topic}: messages that no rule, or not every rule, saw: {unseen_text(counts)}"
    for apart in result.apart:
        yield (
            f"rule {apart['rule']} did not compare {' and '.join(apart['agents'])} {apart['count']} times: they were "
            f"heard of at once, with stamps {apart['seconds']:.1f} s apart; is one of their clocks wrong?"
        )


def _incomplete_rules(detector: EventDetector) -> Iterable[str]:
    for (rule, topic), text in sorted(detector.engine.problems.items()):
        yield f"rule {rule} cannot read {topic}: {text}"
    workers = detector.workers.document() if detector.workers is not None else {}
    for rule, state in workers.items():
        if state["problem"] or state["dropped"]:
            yield f"rule {rule} was suspended, {state['dropped']} messages were not evaluated: {state['problem']}"
