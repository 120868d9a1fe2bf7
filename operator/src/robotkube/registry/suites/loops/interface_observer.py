"""The observer of a running chart: it opens what the chart's inputs need, sends each a message, records what happens.

Everything happens in `turn`s on one thread; every wait has a bound and ends early when nothing more is expected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from robotkube.errors import InputError
from robotkube.registry.catalogue.core.expected_topics import (
    COMMON_TOPICS,
    DATABASE,
    IN,
    MQTT,
    OUT,
    ROS,
    ExpectedTopic,
    outputs_of,
)
from robotkube.registry.suites.core.interface_observations import InputResponse, Observation, ObservedPublication
from robotkube.registry.suites.ports.interfaces import (
    BrokerMessage,
    Messages,
    ObservedBroker,
    ObservedDatabase,
    ObservedNetwork,
)
from robotkube.robots.mqtt.core.batches import MAGIC, BatchError, decode_batch
from robotkube.robots.ros.core.graph import Endpoint
from robotkube.robots.ros.ports import MessageSink, MessageSource

TURN_SECONDS = 0.02
POLL_SECONDS = 0.2
RESEND_SECONDS = 0.3
LOAD_PERIOD_SECONDS = 0.1
QUIET_SECONDS, QUIET_SECONDS_MAX = 0.6, 3.0
WATCH_SECONDS_MIN = 3.0
KEPT_MAX = 500
DEPTH = 20


@dataclass(frozen=True)
class ObserverTimeouts:
    """Timeouts in seconds: until everything is connected, until an input's output must have shown something, and how
    long at least to wait for what comes by itself. Each wait ends as soon as what it waits for is there."""

    settle: float = 6.0
    answer: float = 8.0
    watch: float = 10.0

    def whole(self, inputs: int) -> float:
        """All waits together, at the most."""
        return self.settle + inputs * (self.answer + QUIET_SECONDS_MAX) + self.watch


@dataclass(frozen=True)
class ObserverPorts:
    """The ports of the observer; without broker or database nothing is observed there. `monotonic` in seconds."""

    network: ObservedNetwork
    messages: Messages
    monotonic: Callable[[], float]
    sleep: Callable[[float], None]
    stopped: Callable[[], bool]
    broker: ObservedBroker | None = None
    database: ObservedDatabase | None = None


@dataclass
class InterfaceObserver:
    """One observation of one set of values; call `run` or `load` once, which lasts at most `seconds_max`."""

    expected: Sequence[ExpectedTopic]
    ports: ObserverPorts
    seconds_max: float
    bounds: ObserverTimeouts = field(default_factory=ObserverTimeouts)
    _endpoints: dict[Endpoint, set[str]] = field(default_factory=dict)
    _publications: dict[ObservedPublication, None] = field(default_factory=dict)
    _documents: dict[str, int] = field(default_factory=dict)
    _sinks: dict[int, MessageSink] = field(default_factory=dict)
    _sources: dict[str, MessageSource | None] = field(default_factory=dict)
    _heard: Counter[tuple[str, str]] = field(default_factory=Counter)
    _polled_at: float = float("-inf")

    def run(self) -> Observation:
        """Open, send, watch. InputError when a message type of an input is not installed here."""
        began = self.ports.monotonic()
        self._deadline = began + self.seconds_max
        self._open()
        self._until(self._settled, self.bounds.settle)
        answers = tuple(self._ask(place, topic) for place, topic in self._inputs())
        self._until(lambda: self.ports.monotonic() >= began + WATCH_SECONDS_MIN, WATCH_SECONDS_MIN)
        self._until(self._complete, max(0.0, began + self.bounds.watch - self.ports.monotonic()))
        self._poll()
        return Observation(
            endpoints=tuple(replace(end, node=", ".join(sorted(nodes))) for end, nodes in self._endpoints.items()),
            publications=tuple(self._publications),
            collections=tuple(sorted(self._documents)),
            answers=answers,
            seconds=round(self.ports.monotonic() - began, 1),
        )

    def load(self, seconds: float) -> Observation:
        """Open, and send to every input again and again for `seconds`; nothing is observed of each."""
        began = self.ports.monotonic()
        self._deadline = began + self.seconds_max
        self._open()
        self._until(self._settled, self.bounds.settle)
        due = self.ports.monotonic()
        end = due + seconds

        def over() -> bool:
            nonlocal due
            if self.ports.monotonic() >= due:
                for place, topic in self._inputs():
                    self._send(place, topic)
                due += LOAD_PERIOD_SECONDS
            return self.ports.monotonic() >= end

        self._until(over, seconds)
        return Observation(seconds=round(self.ports.monotonic() - began, 1))

    def _open(self) -> None:
        """Open what the inputs need."""
        for place, topic in self._inputs():
            if topic.medium == ROS:
                # what the entry says that the input needs, and no more: one that asks for more gets nothing in the
                # field either, and one that accepts what it is given shows itself as it is declared
                sink = self.ports.network.advertise(
                    topic.example, topic.type, topic.reliability, topic.durability, DEPTH
                )
                self._sinks[place] = sink

    def _inputs(self) -> Iterator[tuple[int, ExpectedTopic]]:
        return ((place, topic) for place, topic in enumerate(self.expected) if topic.direction == IN)

    def _until(self, reached: Callable[[], bool], seconds: float) -> bool:
        """Turn until that holds; False when the time was over before."""
        end = min(self.ports.monotonic() + seconds, self._deadline)
        while not reached():
            if self.ports.monotonic() >= end or self.ports.stopped():
                return False
            self._turn()
            self.ports.sleep(TURN_SECONDS)
        return True

    def _turn(self) -> None:
        for topic, source in self._sources.items():
            if source is not None:
                self._heard[ROS, topic] += len(source.take())
        for message in self.ports.broker.receive() if self.ports.broker else ():
            self._heard[MQTT, message.topic] += 1
            if len(self._publications) < KEPT_MAX:
                self._publications[self._publication(message)] = None
        if self.ports.monotonic() - self._polled_at >= POLL_SECONDS:
            self._poll()

    def _poll(self) -> None:
        """Poll what does not report by itself: graph and database."""
        self._polled_at = self.ports.monotonic()
        for endpoint in self.ports.network.endpoints():
            self._note(endpoint)
            if endpoint.direction == OUT and endpoint.topic not in self._sources:
                self._listen(endpoint)
        if self.ports.database is not None:
            self._documents = dict(self.ports.database.counts())

    def _note(self, endpoint: Endpoint) -> None:
        """An endpoint is known a moment before the name of its node."""
        unnamed = replace(endpoint, node="")
        if len(self._endpoints) < KEPT_MAX or unnamed in self._endpoints:
            self._endpoints.setdefault(unnamed, set()).update([endpoint.node] if endpoint.node else [])

    def _listen(self, endpoint: Endpoint) -> None:
        """Best effort and volatile: what every publisher serves."""
        self._sources[endpoint.topic] = None
        if (endpoint.topic, OUT) in COMMON_TOPICS or len(self._sources) > KEPT_MAX:
            return
        try:
            source = self.ports.network.subscribe(endpoint.topic, endpoint.type, "best_effort", "volatile", DEPTH)
        except InputError:
            return  # a type that is not installed here: the graph shows it all the same
        self._sources[endpoint.topic] = source

    def _publication(self, message: BrokerMessage) -> ObservedPublication:
        encoding = ""
        problem = ""
        if message.payload.startswith(MAGIC):
            encoding = "rkf1"
            problem = self._batch_problem(message)
        elif message.payload:
            encoding = "text" if _is_text(message.payload) else "binary"
        return ObservedPublication(message.topic, message.qos, message.retain, encoding, problem)

    def _batch_problem(self, message: BrokerMessage) -> str:
        try:
            batch = decode_batch(message.payload)
        except BatchError as error:
            return str(error)
        types = [t.type for t in self.expected if (t.medium, t.direction) == (MQTT, OUT) and t.matches(message.topic)]
        if not types or not types[0] or not batch.messages:
            return ""
        return self.ports.messages.type_mismatch(types[0], batch.messages[0])

    def _settled(self) -> bool:
        """Return whether the inputs are connected and the outputs are listened to."""
        outputs = [topic for topic in self.expected if (topic.medium, topic.direction) == (ROS, OUT)]
        heard = [name for name, source in self._sources.items() if source is not None and source.matched]
        return all(sink.matched for sink in self._sinks.values()) and all(
            any(topic.matches(name) for name in heard) for topic in outputs
        )

    def _complete(self) -> bool:
        """Return whether everything was seen that can be seen from here."""
        return all(self._seen(topic) for topic in self.expected)

    def _seen(self, topic: ExpectedTopic) -> bool:
        if topic.medium == ROS:
            return any(topic.matches(e.topic) for e in self._endpoints if e.direction == topic.direction)
        return topic.direction == IN or (topic.medium == MQTT and self._shown(topic) > 0) or self._stored(topic)

    def _stored(self, topic: ExpectedTopic) -> bool:
        return topic.medium == DATABASE and any(topic.matches(name) for name in self._documents)

    def _shown(self, topic: ExpectedTopic) -> int:
        """How much was seen on an output so far."""
        if topic.medium == DATABASE:
            return sum(count for name, count in self._documents.items() if topic.matches(name))
        return sum(n for (medium, name), n in self._heard.items() if medium == topic.medium and topic.matches(name))

    def _ask(self, place: int, topic: ExpectedTopic) -> InputResponse:
        """Send messages to one input until an output shows something; none any more when the observer shall end."""
        if self.ports.stopped():
            return InputResponse(place, None, 0.0)
        outputs = outputs_of(self.expected, topic)
        self._quiet(outputs)
        before = {output: self._shown(self.expected[output]) for output in outputs}
        began = self.ports.monotonic()
        sent_at = float("-inf")

        def answered() -> bool:
            nonlocal sent_at
            if self.ports.monotonic() - sent_at >= RESEND_SECONDS:
                self._send(place, topic)
                sent_at = self.ports.monotonic()
            return any(self._shown(self.expected[output]) > before[output] for output in outputs)

        if outputs:
            self._until(answered, self.bounds.answer)
        else:
            self._send(place, topic)
        shown = next((output for output in outputs if self._shown(self.expected[output]) > before[output]), None)
        return InputResponse(place, shown, round(self.ports.monotonic() - began, 1))

    def _quiet(self, outputs: Sequence[int]) -> None:
        """Wait until the outputs have shown all that the inputs before this one led to. One that is never quiet, such
        as a clock's, is left as it is."""
        state = [-1]
        since = self.ports.monotonic()

        def quiet() -> bool:
            nonlocal state, since
            now = [self._shown(self.expected[output]) for output in outputs]
            if now != state:
                state = now
                since = self.ports.monotonic()
            return self.ports.monotonic() - since >= QUIET_SECONDS

        self._until(quiet, QUIET_SECONDS_MAX)

    def _send(self, place: int, topic: ExpectedTopic) -> None:
        if topic.medium == ROS:
            self._sinks[place].publish(self.ports.messages.payload(topic))
        elif topic.medium == MQTT and self.ports.broker is not None:
            payload = self.ports.messages.payload(topic)
            self.ports.broker.publish(BrokerMessage(topic.example, payload, topic.qos, topic.retain))
        elif topic.medium == DATABASE and self.ports.database is not None:
            self.ports.database.put(topic.example)


def _is_text(payload: bytes) -> bool:
    try:
        payload.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True
