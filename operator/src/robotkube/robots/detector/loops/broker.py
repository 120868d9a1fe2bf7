"""A detector's connection to the broker: topics that come by MQTT, and messages of reactions that go there.

Everything belongs to the receiving thread, which turns the connection; nothing blocks.

    mqtt/<ROS name>                       batches of messages; type, gaps and trace as user properties
    robotkube/types/mqtt/<ROS name>       definition of the type, retained; for types that are not installed here
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robotkube.errors import InputError
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.detector.core.settings import TopicSettings
from robotkube.robots.mqtt.core.batches import SeenBatches, decode_batch
from robotkube.robots.mqtt.core.message_properties import (
    GAPS,
    MQTT_PREFIX,
    TRACE,
    TYPE,
    TYPES_PREFIX,
    read_gaps,
    types_topic,
)
from robotkube.robots.mqtt.core.properties import content_type, read_properties, user_property
from robotkube.robots.reactions.core.notifications import CONTENT_TYPE
from robotkube.robots.reactions.core.settings import MqttReactionSettings
from robotkube.robots.reactions.loops.dead_letters import DeadLetterBox
from robotkube.robots.reactions.loops.delivery_journal import OPEN_SECONDS_MAX, ReactionJournal
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery
from robotkube.robots.ros.core.gaps import Gap
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile, QosViolations
from robotkube.robots.ros.core.topic_patterns import AGENT

if TYPE_CHECKING:
    from robotkube.robots.detector.ports import TopicInput
    from robotkube.robots.mqtt.ports import ChannelEvents, MqttChannel

QUEUE_MAX = 256
TOPICS_MAX = 1000
DEFINITION_BYTES_MAX = 1_000_000
END_SECONDS_STEP = 0.01
ENDED = "the detector ended"

Learned = Callable[[str], None]

log = logging.getLogger(__name__)


class MqttInput:
    """A topic by MQTT (port TopicInput) with the messages that are not drained yet, at most `depth`. `closed` is called
    when the topic is not wanted any more."""

    def __init__(self, type_name: str, depth: int, closed: Callable[[MqttInput], None]) -> None:
        self.type = type_name
        self.depth = depth
        self._closed = closed
        self._waiting: deque[tuple[bytes, int]] = deque()
        self._seen = SeenBatches()
        self.lost = 0
        self.matched = 0
        self.incompatible = IncompatiblePublishers()
        self.violations = QosViolations()

    def receive(self, payload: bytes, type_name: str, received: int) -> bool:
        """Receive a batch; True when it came for the first time. InputError when it is none, or of another type."""
        if type_name and type_name != self.type:
            raise InputError(f"its messages are {type_name}, not {self.type}; change the topic's type")
        batch = decode_batch(payload)
        self.matched = 1
        if not self._seen.fresh(batch.session, batch.sequence):
            return False
        self._waiting.extend((message, received) for message in batch.messages)
        while len(self._waiting) > self.depth:
            self._waiting.popleft()
            self.lost += 1
        return True

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """See the port."""
        waiting = self._waiting
        return [waiting.popleft() for _ in range(min(len(waiting), messages_max))] if waiting else ()

    def close(self) -> None:
        """See the port; the broker's subscription ends when the settings change."""
        self._waiting.clear()
        self._closed(self)


@dataclass
class _Message:
    topic: str
    body: bytes
    retained: bool
    properties: bytes
    begun: float
    delivery: EdgeDelivery
    sender: MqttReactions


class Broker:
    """The connection to the broker: topics of the source mqtt (port LiveTopics), and messages of MQTT reactions.

    `make` gives the connection for its events; `learned` gets a type whose definition has come, `note_gap` a gap of
    messages that were given up on their way. Nothing is sent while `fencing` is not sure."""

    def __init__(
        self,
        make: Callable[[ChannelEvents], MqttChannel],
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
        learned: Learned,
        note_gap: Callable[[Gap], None],
        fencing: Fencing | None = None,
    ) -> None:
        self._clock_ns = clock_ns
        self._monotonic = monotonic
        self._learned = learned
        self._note_gap = note_gap
        self._fencing = fencing or Fencing()
        self._connected_before = False
        self._announced: Sequence[TopicSettings] = ()
        self._filters: tuple[str, ...] = ()
        self._inputs: dict[str, MqttInput] = {}
        self._waiting: deque[_Message] = deque()
        self._sent: dict[int, _Message] = {}
        self._senders: list[MqttReactions] = []
        self.definitions: dict[str, str] = {}
        self.refusals: dict[str, str] = {}
        self.malformed = 0
        self._reported_topics: set[str] = set()
        self._channel = make(self)
        self._logged_complaint = self._channel.complaint

    @property
    def unreachable(self) -> str:
        """The reason why the broker does not serve the detector, in words; empty when it does."""
        return self._channel.complaint or next(iter(self.refusals.values()), "")

    # port LiveTopics -------------------------------------------------------------------------------------------------

    def announce(self, topics: Sequence[TopicSettings]) -> None:
        """See the port: all of them are subscribed to, with agents that are not known yet."""
        self._announced = tuple(topics)
        before = self._filters
        names = [MQTT_PREFIX + _any_agent(topic.pattern.text) for topic in topics]
        self._filters = tuple(dict.fromkeys([*names, *(types_topic(name) for name in names)]))
        for name in [name for name in self._inputs if self._settings_of(name) is None]:
            del self._inputs[name]
        self._channel.subscribe([topic_filter for topic_filter in self._filters if topic_filter not in before])
        self._channel.unsubscribe([topic_filter for topic_filter in before if topic_filter not in self._filters])

    def subscribe(
        self, topic: str, settings: TopicSettings, qos: QosProfile, before: TopicInput | None = None
    ) -> MqttInput:
        """See the port: there is one input for each topic, and it has the messages that came before."""
        topic_input = self._inputs.get(topic)
        if topic_input is None or topic_input.type != settings.type:
            topic_input = self._inputs[topic] = self._make_input(settings)
        topic_input.depth = settings.depth
        return topic_input

    def visible(self) -> Mapping[str, Sequence[str]]:
        """See the port: the topics of which a message has come."""
        return {name: (topic.type,) for name, topic in self._inputs.items()}

    def offers(self, topic: str) -> Sequence[PublisherOffer]:
        """See the port: publishers are not known here."""
        return ()

    # reactions -------------------------------------------------------------------------------------------------------

    def add_sender(self, sender: MqttReactions) -> None:
        """Send a reaction's messages from now on; every turn collects them."""
        self._senders = [*(known for known in self._senders if not known.over), sender]

    def put(self, message: _Message) -> bool:
        """Queue a message; False when too many wait."""
        if len(self._waiting) + len(self._sent) >= QUEUE_MAX:
            return False
        self._waiting.append(message)
        return True

    def waiting(self, sender: MqttReactions) -> int:
        """The number of messages of a reaction that the broker has not acknowledged."""
        return sum(message.sender is sender for message in [*list(self._waiting), *list(self._sent.values())])

    def turn(self) -> None:
        """Read what has arrived and write what waits."""
        now = self._monotonic()
        self._channel.turn(now)
        self._log_complaint()
        for sender in self._senders:
            sender.queue_new(now)
        while self._waiting and now - self._waiting[0].begun > self._waiting[0].sender.retry_seconds:
            message = self._waiting.popleft()
            message.sender.give_up(message.delivery, self.unreachable or "the broker has not acknowledged it")
        while self._waiting and not self._fencing.fenced:
            message = self._waiting[0]
            token = self._channel.publish(message.topic, message.body, message.retained, message.properties)
            if token is None:
                break
            self._sent[token] = self._waiting.popleft()
        self._channel.flush()

    def _log_complaint(self) -> None:
        """Log the reason why there is no connection, once for each reason."""
        complaint = self._channel.complaint
        if complaint is not None and complaint != self._logged_complaint:
            log.warning("broker: %s", complaint)
        self._logged_complaint = complaint

    def close(self, seconds: float, pause: Callable[[float], None]) -> bool:
        """Deliver what waits within `seconds`, then disconnect; True when nothing is left."""
        end = self._monotonic() + seconds
        for sender in self._senders:
            sender.queue_new(end)
        while (self._waiting or self._sent) and not self._cannot_deliver and self._monotonic() < end:
            self.turn()
            pause(END_SECONDS_STEP)
        left = [*self._sent.values(), *self._waiting]
        for message in left:
            message.sender.leave(message.delivery, ENDED)
        self._channel.close()
        return not left

    @property
    def _cannot_deliver(self) -> bool:
        return bool(self.unreachable) or self._fencing.lost

    # events of the connection ----------------------------------------------------------------------------------------

    def connected(self, session_kept: bool) -> None:
        """See the port ChannelEvents."""
        log.info("broker: connected session_kept=%s", session_kept)
        if self._connected_before:
            self._fencing.interrupted()
        self._connected_before = True
        self.refusals.clear()
        self._channel.subscribe(self._filters)

    def disconnected(self) -> None:
        """See the port: messages that were not acknowledged are sent again, in their order."""
        self._logged_complaint = self._channel.complaint
        log.warning("broker: %s", self._logged_complaint)
        for message in self._sent.values():
            message.sender.retries += 1
        self._waiting.extendleft(reversed(self._sent.values()))
        self._sent.clear()

    def acknowledged(self, token: int, heard: bool) -> None:
        """See the port."""
        if (message := self._sent.pop(token, None)) is not None:
            message.sender.deliver(message.delivery)

    def rejected(self, token: int, reason: str) -> None:
        """See the port."""
        if (message := self._sent.pop(token, None)) is not None:
            message.sender.give_up(message.delivery, f"{message.topic}: {reason}")

    def granted(self, topic: str) -> None:
        """See the port."""
        if self.refusals.pop(topic, None) is not None:
            log.info("broker: granted topic=%s", topic)

    def refused(self, topic: str, reason: str) -> None:
        """See the port; a refused topic of types is no problem but for types that are not installed."""
        if not topic.startswith(TYPES_PREFIX):
            self.refusals[topic] = f"{topic}: {reason}"
        log.warning("broker: %s: %s", topic, reason)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """See the port."""
        if not payload:
            return  # a retained message was taken back
        try:
            user = read_properties(properties).user
            type_name = user.get(TYPE, "")
            if topic.startswith(TYPES_PREFIX):
                self._learn(topic.removeprefix(types_topic(MQTT_PREFIX)), type_name, payload)
            elif (topic_input := self._input(topic.removeprefix(MQTT_PREFIX))) is not None:
                gaps = read_gaps(user[GAPS]) if GAPS in user else ()
                if topic_input.receive(payload, type_name, self._clock_ns()):
                    for gap in gaps:
                        self._note_gap(gap)
        except InputError as error:
            self.malformed += 1
            if topic not in self._reported_topics and len(self._reported_topics) < TOPICS_MAX:
                self._reported_topics.add(topic)
                log.warning("topic %s: %s", topic, error)

    def _learn(self, name: str, type_name: str, payload: bytes) -> None:
        """Learn the definition of a type from an agent, which can define only the type of its own topic."""
        settings = self._settings_of(name)
        if settings is None or type_name != settings.type or len(payload) > DEFINITION_BYTES_MAX:
            wanted = "a topic that is followed" if settings is None else settings.type
            raise InputError(
                f"{len(payload)} bytes for type {type_name!r} are no definition of {wanted}; "
                f"at most {DEFINITION_BYTES_MAX} bytes of text and the property `type` are needed"
            )
        text = payload.decode(errors="replace")
        if self.definitions.get(type_name) != text:
            self.definitions[type_name] = text
            self._learned(type_name)

    def _input(self, name: str) -> MqttInput | None:
        topic_input = self._inputs.get(name)
        if topic_input is None and len(self._inputs) < TOPICS_MAX:
            settings = self._settings_of(name)
            if settings is not None:
                topic_input = self._inputs[name] = self._make_input(settings)
        return topic_input

    def _make_input(self, settings: TopicSettings) -> MqttInput:
        return MqttInput(settings.type, settings.depth, self._forget)

    def _forget(self, closed: MqttInput) -> None:
        """Forget an input; the next message of its topic makes another."""
        self._inputs = {name: topic_input for name, topic_input in self._inputs.items() if topic_input is not closed}

    def _settings_of(self, name: str) -> TopicSettings | None:
        return next((settings for settings in self._announced if settings.pattern.agent(name) is not None), None)


class MqttReactions:
    """The deliveries of an MQTT reaction (port Reaction); all methods belong to the receiving thread."""

    def __init__(
        self,
        settings: MqttReactionSettings,
        broker: Broker,
        box: DeadLetterBox,
        clock: Callable[[], float],
        journal: ReactionJournal | None = None,
    ) -> None:
        self.name = settings.name
        self.retry_seconds = settings.retry_seconds
        self._settings = settings
        self._broker = broker
        self._box = box
        self._clock = clock
        self.delivered = self.retries = self.dead = 0
        self._journal = journal or ReactionJournal()
        self._new = deque[EdgeDelivery]()
        self._journal_awaited_until = clock() + OPEN_SECONDS_MAX
        self._stopped = False
        broker.add_sender(self)

    @property
    def unreachable(self) -> str:
        """See the port."""
        return self._broker.unreachable

    def react(self, delivery: EdgeDelivery) -> None:
        """See the port."""
        self._journal.add(delivery)
        if len(self._new) < QUEUE_MAX:
            self._new.append(delivery)
            self.queue_new(self._clock())
        else:
            self.give_up(delivery, f"{QUEUE_MAX} messages wait for the broker already")

    def queue_new(self, now: float) -> None:
        """Queue new deliveries at the broker's connection, behind those that an earlier process has left."""
        if not self._journal.settled and now < self._journal_awaited_until:
            return
        for delivery in self._journal.from_predecessor():
            self._put(delivery)
        while self._new:
            self._put(self._new.popleft())

    def _put(self, delivery: EdgeDelivery) -> None:
        properties = (
            content_type(CONTENT_TYPE) + user_property(TRACE, delivery.trace) + user_property("id", delivery.id)
        )
        retained = self._settings.retained
        now = self._clock()
        message = _Message(self._settings.topic, delivery.body, retained, properties, now, delivery, self)
        if not self._broker.put(message):
            self.give_up(delivery, f"{QUEUE_MAX} messages wait for the broker already")

    def counts(self) -> Mapping[str, int]:
        """See the port."""
        waiting = self._broker.waiting(self) + len(self._new)
        return {"delivered": self.delivered, "retries": self.retries, "dead": self.dead, "waiting": waiting}

    def stop(self, seconds: float) -> bool:
        """See the port: the broker's connection delivers what waits when it is closed."""
        self._stopped = True
        return True

    @property
    def over(self) -> bool:
        """Return whether it is stopped and has no delivery to queue."""
        return self._stopped and not self._new

    def deliver(self, delivery: EdgeDelivery) -> None:
        """Record that the broker has a delivery."""
        self.delivered += 1
        self._journal.done(delivery)

    def leave(self, delivery: EdgeDelivery, reason: str) -> None:
        """Leave a delivery to the next process when that will find it, else give it up."""
        if self._journal.outlives(delivery):
            log.warning("reaction %s: %s is left to the next process: %s", self.name, delivery.id, reason)
        else:
            self.give_up(delivery, reason)

    def give_up(self, delivery: EdgeDelivery, reason: str) -> None:
        """Make a delivery a dead letter."""
        self.dead += 1
        self._box.add(self.name, delivery.id, reason)
        self._journal.done(delivery)


def _any_agent(name: str) -> str:
    """The MQTT filter of a pattern's topics: the level that names the agent is any."""
    return "/".join("+" if AGENT in level else level for level in name.split("/"))
