"""Rules tried on bags: the detector's own service, fed from bags instead of the network and driven by their clock.

What runs is EventDetector as in a vehicle, with the same buffers, stamps and rules; only who hands in the messages, who
reads the clock and who hears of the events is different. Rules in processes of their own are waited for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NoReturn

from robotkube.domain.detector_settings import ACTIVE, DetectorSettings, TopicSettings
from robotkube.domain.errors import InputError
from robotkube.domain.layouts import Layouts
from robotkube.domain.qualities import Broken, Incompatible, Offer, Quality
from robotkube.domain.rules import Edge, Verdict
from robotkube.services.detector.detector import EventDetector
from robotkube.services.detector.raising import Raising
from robotkube.services.detector.recording import RecordingReactions
from robotkube.services.detector.topic import Topic
from robotkube.services.detector.topics import SUBSCRIPTIONS_MAX
from robotkube.services.rule_workers import RuleWorkers

if TYPE_CHECKING:
    from robotkube.ports.robots import TopicInput

CLOCKS_APART_NS = 60_000_000_000
"""Stamps that are so far from the bags' times are of another clock: simulated time, or a bag recorded from a bag."""
CLOCK_MESSAGES = 20
"""So many messages of each topic are looked at for that."""
TURN_NS = 10_000_000
"""Messages of so long are handed in at once, as they are where they come from a network."""
PAUSE_NS = 2_000_000_000
PAUSE_TURNS_NS = (1_200_000_000, 150_000_000)
"""When nothing has come for so long, the detector looks for topics so long before the next message, as it would live:
what has expired is forgotten, and found again, before it comes."""
EDGES_MAX = 1_000_000
TURNS_MAX = 100_000

BagMessages = Iterable[tuple[str, int, bytes]]


@dataclass
class BagInput:
    """A subscription (port TopicInput)."""

    waiting: deque[tuple[bytes, int]] = field(default_factory=deque)
    lost: int = 0
    closed: bool = False
    matched: int = 1
    incompatible: Incompatible = field(default_factory=Incompatible)
    broken: Broken = field(default_factory=Broken)

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """See the port."""
        if len(self.waiting) <= messages_max:
            found = list(self.waiting)
            self.waiting.clear()
            return found
        return [self.waiting.popleft() for _ in range(messages_max)]

    def close(self) -> None:
        """See the port. What waits is kept: in a bag it waits for the topic to be found again."""
        self.closed = True


class BagTopics:
    """Topics of bags as a detector sees them (port LiveTopics). `types`: topic -> its type."""

    def __init__(self, types: Mapping[str, str]) -> None:
        self._types = types
        self.inputs: dict[str, BagInput] = {}

    def follow(self, topics: Sequence[TopicSettings]) -> None:
        """See the port."""

    def subscribe(
        self, topic: str, settings: TopicSettings, quality: Quality, before: TopicInput | None = None
    ) -> BagInput:
        """See the port."""
        found = self.inputs.setdefault(topic, BagInput())
        found.closed = False
        return found

    def visible(self) -> Mapping[str, Sequence[str]]:
        """See the port."""
        return {name: (type_name,) for name, type_name in self._types.items()}

    def offers(self, topic: str) -> Sequence[Offer]:
        """See the port."""
        return ()

    @property
    def waiting(self) -> bool:
        """Whether messages of subscriptions have not been drained."""
        return any(found.waiting and not found.closed for found in self.inputs.values())


class PatientWorkers(RuleWorkers):
    """Processes of rules whose answers are waited for: a replay is faster than they are."""

    _settling = False

    def collect(self) -> list[Verdict]:
        """All verdicts on what was asked."""
        if self._settling:
            return super().collect()
        self._settling = True
        try:
            return self.settle()
        finally:
            self._settling = False


class _Listening(Raising):
    """Keeps the edges, and tells nobody."""

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        super().__init__(_refuse, _refuse, clock_ns)
        self.edges: list[Edge] = []

    def react(self, edge: Edge) -> None:
        """One edge more."""
        if len(self.edges) >= EDGES_MAX:
            raise InputError(f"the rules raise more than {EDGES_MAX} edges; give them cooldown_seconds or hysteresis")
        self.edges.append(edge)


def _refuse(*_: object) -> NoReturn:
    raise AssertionError("a replay has no reactions")


@dataclass
class Replayed:
    """What the rules said. `first`, `last`: times of the bags in ns, 0 without a message; `begin`: what `first` is on
    the clock of the messages' stamps; `messages` were read of topics that rules look at; `malformed`: topic -> messages
    that are none of their type; `unsaid`: rules that could not look at all messages, and why; `problems`: what else to
    know about the result."""

    edges: list[Edge] = field(default_factory=list)
    messages: int = 0
    first: int = 0
    begin: int = 0
    last: int = 0
    malformed: dict[str, int] = field(default_factory=dict)
    unsaid: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def topics_read(settings: DetectorSettings, types: Mapping[str, str]) -> Collection[str]:
    """The topics of the bags that rules look at; nothing else has to be read."""
    patterns = {pattern for rule in settings.rules for pattern in rule.topics}
    by_pattern = {topic.pattern: topic.type for topic in settings.topics}
    return {
        name
        for name, type_name in types.items()
        if any(pattern.agent(name) is not None and by_pattern.get(pattern) == type_name for pattern in patterns)
    }


@dataclass
class _Clock:
    """How far the messages' stamps are behind the bags' times; `seen`: topic -> messages looked at."""

    seen: dict[str, int] = field(default_factory=dict)
    _least: int | None = None

    def look(self, topic: Topic | None, name: str, data: bytes, moment: int) -> None:
        """One of a topic's first messages."""
        self.seen[name] = self.seen.get(name, 0) + 1
        try:
            stamp = topic.stamp(data) if topic is not None and topic.stamp is not None else 0
        except ValueError:
            return
        if stamp and (self._least is None or abs(moment - stamp) < abs(self._least)):
            self._least = moment - stamp

    @property
    def lag(self) -> int:
        """0 when it is the same clock; ns."""
        return self._least if self._least is not None and abs(self._least) > CLOCKS_APART_NS else 0

    def problems(self, begin: int) -> Iterable[str]:
        """What to know about that."""
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
) -> Replayed:
    """Play `messages` (topic, time, bytes; times ascending) through a detector with these settings, as fast as it goes.

    `types`: topic -> type of what is in the bags. InputError when there are more than EDGES_MAX edges."""
    result, clock = Replayed(), _Clock()
    now = begin = 0

    def clock_ns() -> int:
        return now

    source, listening = BagTopics(types), _Listening(clock_ns)
    detector = EventDetector(
        lambda _: source, layouts, listening, RecordingReactions(_refuse), make_workers, clock_ns, lambda: now / 1e9
    )
    try:
        for name, moment, data in messages:
            if not result.messages:
                result.first = now = begin = moment
                detector.apply(replace(settings, reactions=(), task="", bag="", state=ACTIVE))
                detector.turn()  # subscribes to what patterns find
            elif moment > begin + turn_ns:
                _turns(detector, source)
                for before in PAUSE_TURNS_NS if moment - now > PAUSE_NS else ():
                    now = moment - before
                    detector.turn()
                begin = moment
            result.messages += 1
            now = result.last = max(now, moment)
            found = source.inputs.get(name)
            if found is not None:
                found.waiting.append((data, moment))
            if clock.seen.get(name, 0) < CLOCK_MESSAGES:
                clock.look(detector.topics.topics.get(name), name, data, moment)
        if result.messages:
            _turns(detector, source)
            _turns(detector, source)  # what processes answered to the last messages
        result.edges = sorted(listening.edges, key=lambda edge: edge.stamp)
        result.malformed = {n: c.malformed for n, c in detector.topics.counters().items() if c.malformed}
        result.unsaid = list(_unsaid(detector))
        result.begin = result.first - clock.lag
        result.problems = list(clock.problems(result.begin))
        result.problems += [
            f"{name}: not read: {SUBSCRIPTIONS_MAX} topics are" for name in sorted(set(clock.seen) - set(source.inputs))
        ]
    finally:
        detector.stop()
    return result


def _turns(detector: EventDetector, source: BagTopics) -> None:
    for _ in range(TURNS_MAX):
        detector.turn()
        if not source.waiting:
            return


def _unsaid(detector: EventDetector) -> Iterable[str]:
    for (rule, topic), text in sorted(detector.engine.problems.items()):
        yield f"rule {rule} cannot read {topic}: {text}"
    workers = detector.workers.document() if detector.workers is not None else {}
    for rule, state in workers.items():
        if state["problem"] or state["dropped"]:
            yield f"rule {rule} was suspended, {state['dropped']} messages were not evaluated: {state['problem']}"
