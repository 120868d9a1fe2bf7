"""The two directions of a bridge's topic: serialised messages to batches for the broker, and back."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robotkube.errors import UnavailableError
from robotkube.robots.bridge.core import mqtt_client_format
from robotkube.robots.bridge.core.settings import MQTT_CLIENT, BridgedTopic
from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch
from robotkube.robots.mqtt.core.batches import BatchError, SeenBatches, decode_batch, encode_batch
from robotkube.robots.mqtt.core.message_properties import (
    GAPS,
    TYPE,
    read_gaps,
    stamp_property,
    type_properties,
    types_topic,
)
from robotkube.robots.mqtt.core.properties import message_expiry, read_properties
from robotkube.robots.ros.core.common_messages import STAMPED_TYPES, header_stamp, string_message, string_text
from robotkube.robots.ros.core.gaps import Gap

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.robots.ros.ports import MessageSink, MessageSource

BATCH_BYTES_MAX = 1_000_000
HOLD_SECONDS_MAX = 3.0
HELD_MESSAGES_MAX = 2_000
HELD_BYTES_MAX = 32 * 1024 * 1024
DEFINITION_ENCODING = "text/x-ros2msg"
NOT_ACCEPTED = "not accepted by the middleware"

OnLoss = Callable[[Gap], None]
OnGaps = Callable[[Sequence[Gap]], None]


@dataclass
class SendingSession:
    """The session that all outgoing topics share. `clock` gives ns since 1970; `definition` a type's definition, or
    nothing."""

    session: int
    clock: Callable[[], int]
    definition: Callable[[str], str]
    trace: str = ""
    sequences: dict[str, int] = field(default_factory=dict)

    def sequence(self, name: str) -> int:
        """The next number of a topic."""
        number = self.sequences.get(name, 0)
        self.sequences[name] = number + 1
        return number


class Outgoing:
    """A topic that goes to the broker."""

    def __init__(self, topic: BridgedTopic, source: MessageSource, sender: SendingSession) -> None:
        self.topic = topic
        self.source = source
        self.messages = self.matched = self.malformed = 0
        self._sender = sender
        self._has_header = topic.type in STAMPED_TYPES
        self._deadline = 0.0 if topic.retained else topic.deadline_seconds
        expiry = message_expiry(self._deadline) if self._deadline else b""
        self._properties = type_properties(topic.type, sender.trace) + expiry
        of_messages = self._single_batches if topic.format == MQTT_CLIENT else self._message_batches
        self.batches: Callable[[Sequence[bytes], float], Iterator[OutgoingBatch]]
        self.batches = self._text_batches if topic.gateway_agent else of_messages

    def introduction(self, now: float, publish_types: bool) -> Iterator[OutgoingBatch]:
        """The batches that are retained at the broker beside the messages: their type or its definition."""
        topic = self.topic
        if topic.format == MQTT_CLIENT:
            kind = mqtt_client_format.encode_type(mqtt_client_format.RosMessageType(topic.type, topic.inject_timestamp))
            yield OutgoingBatch(mqtt_client_format.type_topic(topic.mqtt), kind, 0, True, now)
        elif publish_types and not topic.gateway_agent and (text := self._sender.definition(topic.type)):
            properties = type_properties(topic.type, "", DEFINITION_ENCODING)
            yield OutgoingBatch(types_topic(topic.mqtt), text.encode(), 0, True, now, properties)

    def _message_batches(self, messages: Sequence[bytes], now: float) -> Iterator[OutgoingBatch]:
        """Batches of many messages each."""
        sender = self._sender
        topic = self.topic
        for part in parts(messages):
            payload = encode_batch(sender.session, sender.sequence(topic.name), part)
            yield self._batch(payload, part, now)

    def _single_batches(self, messages: Sequence[bytes], now: float) -> Iterator[OutgoingBatch]:
        """Batches of one message each, as ika's mqtt_client writes it."""
        for message in messages:
            stamp = self._sender.clock() if self.topic.inject_timestamp else None
            yield self._batch(mqtt_client_format.encode_message(message, stamp), (message,), now)

    def _text_batches(self, messages: Sequence[bytes], now: float) -> Iterator[OutgoingBatch]:
        """The texts of String messages, each as it is."""
        for message in messages:
            try:
                text = string_text(message)
                yield OutgoingBatch(self.topic.mqtt, text, 1, born=now, deadline_seconds=self._deadline)
            except ValueError:
                self.malformed += 1

    def _batch(self, payload: bytes, messages: Sequence[bytes], now: float) -> OutgoingBatch:
        topic = self.topic
        first = self._stamp(messages[0])
        last = first if len(messages) == 1 else self._stamp(messages[-1])
        properties = self._properties + stamp_property(first)
        return OutgoingBatch(
            topic.mqtt, payload, len(messages), topic.retained, now, properties, topic.name, first, last, (),
            self._deadline,
        )  # fmt: skip

    def _stamp(self, message: bytes) -> int:
        """The message's own stamp, else the time now."""
        if self._has_header:
            try:
                return max(0, header_stamp(message))
            except ValueError:
                self.malformed += 1
        return self._sender.clock()


class Incoming:
    """A topic that comes from the broker. The first messages are held until a subscription has discovered the
    publisher, at most for HOLD_SECONDS_MAX: the middleware gives them to nobody who comes later."""

    def __init__(self, topic: BridgedTopic, sink: MessageSink, on_loss: OnLoss, on_gaps: OnGaps) -> None:
        self.topic = topic
        self.sink = sink
        self.seen = SeenBatches()
        self.messages = self.matched = self.lost_messages = 0
        self.latency_seconds = 0.0
        self.announced = self.stamped = False
        self._on_loss = on_loss
        self._on_gaps = on_gaps
        self._has_header = topic.type in STAMPED_TYPES
        self._held: deque[bytes] | None = deque()
        self._held_bytes = 0
        self._held_since = 0
        of_messages = self._single if topic.format == MQTT_CLIENT else self._batch
        self._decode: Callable[[bytes, bytes, int], Sequence[bytes]]
        self._decode = self._text if topic.gateway_agent else of_messages

    def receive(self, payload: bytes, properties: bytes, clock_ns: int) -> None:
        """Publish the messages of a payload, unless it was here before. BatchError: it is something else, and nothing
        was published."""
        self.publish(self._decode(payload, properties, clock_ns), clock_ns)

    def publish(self, messages: Sequence[bytes], clock_ns: int) -> None:
        """Publish serialised messages now, or once somebody listens."""
        if self._held is None:
            self._publish(messages, clock_ns)
            return
        self._held_since = self._held_since if self._held else clock_ns
        self._held += messages
        self._held_bytes += sum(map(len, messages))
        if len(self._held) > HELD_MESSAGES_MAX or self._held_bytes > HELD_BYTES_MAX or self.sink.matched:
            self._release(clock_ns)

    def announce(self, kind: mqtt_client_format.RosMessageType) -> None:
        """Note the type of mqtt_client's messages from now on; BatchError when it is not the topic's."""
        self.announced = kind.name == self.topic.type
        if not self.announced:
            raise BatchError(f"its type is {kind.name}, that of the topic {self.topic.type}; make the two the same")
        self.stamped = kind.stamped

    @property
    def holding(self) -> bool:
        """Return whether messages wait for a subscription to discover the publisher."""
        return self._held is not None

    def turn(self, clock_ns: int) -> None:
        """Publish what is held when somebody listens or its time is over."""
        if self._held is None:
            return
        late = bool(self._held) and clock_ns - self._held_since >= HOLD_SECONDS_MAX * 1e9
        if late or self.sink.matched:
            self._release(clock_ns)

    def _release(self, clock_ns: int) -> None:
        held = self._held or ()
        self._held = None
        self._held_bytes = 0
        self._publish(held, clock_ns)

    def _publish(self, messages: Sequence[bytes] | deque[bytes], clock_ns: int) -> None:
        publish = self.sink.publish
        for message in messages:
            try:
                publish(message)
                self.messages += 1
            except UnavailableError:
                self.lost_messages += 1
                stamp = self._stamp(message, clock_ns)
                self._on_loss(Gap(self.topic.name, "ros", NOT_ACCEPTED, 1, stamp, stamp))

    def _batch(self, payload: bytes, properties: bytes, clock_ns: int) -> Sequence[bytes]:
        batch = decode_batch(payload)
        user = read_properties(properties).user if properties else {}
        if user.get(TYPE, self.topic.type) != self.topic.type:
            raise BatchError(f"its type is {user[TYPE]}, that of the topic {self.topic.type}; make the two the same")
        gaps = read_gaps(user[GAPS]) if GAPS in user else ()
        if not self.seen.fresh(batch.session, batch.sequence):
            return ()
        if gaps:
            self._on_gaps(gaps)
        return batch.messages

    def _single(self, payload: bytes, properties: bytes, clock_ns: int) -> Sequence[bytes]:
        if not self.announced:  # of a session that is older than this process, or of another type by now
            raise BatchError("its type is not announced, nor whether it is stamped")
        message, stamp = mqtt_client_format.decode_message(payload, self.stamped)
        if stamp is not None:
            self.latency_seconds = (clock_ns - stamp) / 1e9
        return (message,)

    def _text(self, payload: bytes, properties: bytes, clock_ns: int) -> Sequence[bytes]:
        return (string_message(payload),)

    def _stamp(self, message: bytes, clock_ns: int) -> int:
        try:
            return max(0, header_stamp(message)) if self._has_header else clock_ns
        except ValueError:
            return clock_ns


def parts(messages: Sequence[bytes]) -> Iterator[Sequence[bytes]]:
    """`messages` in parts of at most BATCH_BYTES_MAX bytes; a larger message stands alone."""
    begin = size = 0
    for index, message in enumerate(messages):
        size += len(message)
        if size > BATCH_BYTES_MAX and index > begin:
            yield messages[begin:index]
            begin = index
            size = len(message)
    yield messages[begin:]
