"""A detector's connection to the broker: topics that come by MQTT, and messages of reactions that go there.

Everything belongs to the receiving thread, which turns the connection; nothing blocks.

    mqtt/<ROS name>                       frames of messages; type, gaps and trace as user properties
    robotkube/types/mqtt/<ROS name>       definition of the type, retained; for types that are not installed here
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robotkube.domain.audits import Gap
from robotkube.domain.bridging import MQTT_PREFIX
from robotkube.domain.bridging_properties import GAPS, TRACE, TYPE, TYPES_PREFIX, read_gaps, types_topic
from robotkube.domain.detector_settings import TopicSettings
from robotkube.domain.errors import InputError
from robotkube.domain.frames import SeenFrames, decode_frame
from robotkube.domain.mqtt_properties import content_type, read_properties, user_property
from robotkube.domain.notifications import CONTENT_TYPE
from robotkube.domain.qualities import Broken, Incompatible, Offer, Quality
from robotkube.domain.reaction_settings import MqttReaction
from robotkube.domain.topics import AGENT
from robotkube.ports.reactions import Delivery
from robotkube.services.ownership import Ownership
from robotkube.services.reactions.dead import DeadLetterBox
from robotkube.services.reactions.keeping import OPEN_SECONDS_MAX, Kept

if TYPE_CHECKING:
    from robotkube.ports.robots import ChannelEvents, FrameChannel, TopicInput

QUEUE_MAX = 256
TOPICS_MAX = 1000
DEFINITION_BYTES_MAX = 1_000_000
END_SECONDS_STEP = 0.01
ENDED = "the detector ended"

Learned = Callable[[str], None]

log = logging.getLogger(__name__)


class MqttInput:
    """One topic by MQTT (port TopicInput): what came and is not drained yet, at most `depth` messages. `closed` is told
    when nobody wants it any more."""

    def __init__(self, type_name: str, depth: int, closed: Callable[[MqttInput], None]) -> None:
        self.type, self.depth, self._closed = type_name, depth, closed
        self._waiting: deque[tuple[bytes, int]] = deque()
        self._seen = SeenFrames()
        self.lost = 0
        self.matched = 0
        self.incompatible, self.broken = Incompatible(), Broken()

    def take(self, payload: bytes, type_name: str, received: int) -> bool:
        """A frame came: whether for the first time. InputError when it is none, or of another type."""
        if type_name and type_name != self.type:
            raise InputError(f"its messages are {type_name}, not {self.type}; change the topic's type")
        frame = decode_frame(payload)
        self.matched = 1
        if not self._seen.fresh(frame.session, frame.sequence):
            return False
        self._waiting.extend((message, received) for message in frame.messages)
        while len(self._waiting) > self.depth:
            self._waiting.popleft()
            self.lost += 1
        return True

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """See the port."""
        waiting = self._waiting
        return [waiting.popleft() for _ in range(min(len(waiting), messages_max))] if waiting else ()

    def close(self) -> None:
        """See the port; the broker is told when the settings change."""
        self._waiting.clear()
        self._closed(self)


@dataclass
class _Message:
    topic: str
    body: bytes
    retained: bool
    properties: bytes
    begun: float
    delivery: Delivery
    sender: MqttReactions


class Broker:
    """Port LiveTopics for the source mqtt, and what MQTT reactions write to.

    `make` gives the connection for its events; `learned` is told of a type whose definition has come, `lacking` of
    messages that were given up on their way. Nothing is sent while `ownership` is not sure."""

    def __init__(
        self,
        make: Callable[[ChannelEvents], FrameChannel],
        clock_ns: Callable[[], int],
        monotonic: Callable[[], float],
        learned: Learned,
        lacking: Callable[[Gap], None],
        ownership: Ownership | None = None,
    ) -> None:
        self._clock_ns, self._monotonic, self._learned, self._lacking = clock_ns, monotonic, learned, lacking
        self._ownership = ownership or Ownership()
        self._connected_before = False
        self._followed: Sequence[TopicSettings] = ()
        self._filters: tuple[str, ...] = ()
        self._inputs: dict[str, MqttInput] = {}
        self._waiting: deque[_Message] = deque()
        self._sent: dict[int, _Message] = {}
        self._senders: list[MqttReactions] = []
        self.definitions: dict[str, str] = {}
        self.refusals: dict[str, str] = {}
        self.malformed = 0
        self._complained: set[str] = set()
        self._channel = make(self)
        self._told = self._channel.complaint

    @property
    def unreachable(self) -> str:
        """Why the broker does not serve us, in words; empty when it does."""
        return self._channel.complaint or next(iter(self.refusals.values()), "")

    # port LiveTopics -------------------------------------------------------------------------------------------------

    def follow(self, topics: Sequence[TopicSettings]) -> None:
        """See the port: the broker is asked for all of them, agents that are not known yet included."""
        self._followed, before = tuple(topics), self._filters
        names = [MQTT_PREFIX + _any_agent(topic.pattern.text) for topic in topics]
        self._filters = tuple(dict.fromkeys([*names, *(types_topic(name) for name in names)]))
        for name in [name for name in self._inputs if self._settings_of(name) is None]:
            del self._inputs[name]
        self._channel.subscribe([one for one in self._filters if one not in before])
        self._channel.unsubscribe([one for one in before if one not in self._filters])

    def subscribe(
        self, topic: str, settings: TopicSettings, quality: Quality, before: TopicInput | None = None
    ) -> MqttInput:
        """See the port: what came before is there, and there is one for each topic."""
        found = self._inputs.get(topic)
        if found is None or found.type != settings.type:
            found = self._inputs[topic] = self._make_input(settings)
        found.depth = settings.depth
        return found

    def visible(self) -> Mapping[str, Sequence[str]]:
        """See the port: those of which something has come."""
        return {name: (topic.type,) for name, topic in self._inputs.items()}

    def offers(self, topic: str) -> Sequence[Offer]:
        """See the port: publishers do not show themselves here."""
        return ()

    # reactions -------------------------------------------------------------------------------------------------------

    def listen(self, sender: MqttReactions) -> None:
        """Take a reaction's messages from now on; it is asked for them at every turn."""
        self._senders = [*(one for one in self._senders if not one.over), sender]

    def put(self, message: _Message) -> bool:
        """Send a message when its turn comes; False when too many wait."""
        if len(self._waiting) + len(self._sent) >= QUEUE_MAX:
            return False
        self._waiting.append(message)
        return True

    def waiting(self, sender: MqttReactions) -> int:
        """How many messages of a reaction the broker has not acknowledged."""
        return sum(one.sender is sender for one in [*list(self._waiting), *list(self._sent.values())])

    def turn(self) -> None:
        """Read and write what is there."""
        now = self._monotonic()
        self._channel.turn(now)
        self._tell_complaint()
        for sender in self._senders:
            sender.hand_over(now)
        while self._waiting and now - self._waiting[0].begun > self._waiting[0].sender.retry_seconds:
            one = self._waiting.popleft()
            one.sender.give_up(one.delivery, self.unreachable or "the broker has not acknowledged it")
        while self._waiting and self._ownership.sure:
            one = self._waiting[0]
            token = self._channel.publish(one.topic, one.body, one.retained, one.properties)
            if token is None:
                break
            self._sent[token] = self._waiting.popleft()
        self._channel.flush()

    def _tell_complaint(self) -> None:
        """Why there is no connection stands in the log, once for each reason."""
        complaint = self._channel.complaint
        if complaint is not None and complaint != self._told:
            log.warning("broker: %s", complaint)
        self._told = complaint

    def close(self, seconds: float, pause: Callable[[float], None]) -> bool:
        """Deliver what waits within `seconds`, then part; True when nothing is left."""
        end = self._monotonic() + seconds
        for sender in self._senders:
            sender.hand_over(end)
        while (self._waiting or self._sent) and not self._is_in_vain and self._monotonic() < end:
            self.turn()
            pause(END_SECONDS_STEP)
        left = [*self._sent.values(), *self._waiting]
        for one in left:
            one.sender.leave(one.delivery, ENDED)
        self._channel.close()
        return not left

    @property
    def _is_in_vain(self) -> bool:
        return bool(self.unreachable) or self._ownership.lost

    # events of the connection ----------------------------------------------------------------------------------------

    def connected(self, session_kept: bool) -> None:
        """See the port ChannelEvents."""
        log.info("broker: connected session_kept=%s", session_kept)
        if self._connected_before:
            self._ownership.doubt()
        self._connected_before = True
        self.refusals.clear()
        self._channel.subscribe(self._filters)

    def disconnected(self) -> None:
        """See the port: what was not acknowledged is sent again, in its order."""
        self._told = self._channel.complaint
        log.warning("broker: %s", self._told)
        for one in self._sent.values():
            one.sender.retries += 1
        self._waiting.extendleft(reversed(self._sent.values()))
        self._sent.clear()

    def acknowledged(self, token: int, heard: bool) -> None:
        """See the port."""
        if (one := self._sent.pop(token, None)) is not None:
            one.sender.deliver(one.delivery)

    def rejected(self, token: int, reason: str) -> None:
        """See the port."""
        if (one := self._sent.pop(token, None)) is not None:
            one.sender.give_up(one.delivery, f"{one.topic}: {reason}")

    def refused(self, topic: str, reason: str) -> None:
        """See the port; that a broker keeps types to itself costs only what is not installed."""
        if not topic.startswith(TYPES_PREFIX):
            self.refusals[topic] = f"{topic}: {reason}"
        log.warning("broker: %s: %s", topic, reason)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """See the port."""
        if not payload:
            return  # a retained message was taken back
        try:
            user = read_properties(properties).user
            said = user.get(TYPE, "")
            if topic.startswith(TYPES_PREFIX):
                self._learn(topic.removeprefix(types_topic(MQTT_PREFIX)), said, payload)
            elif (found := self._input(topic.removeprefix(MQTT_PREFIX))) is not None:
                gaps = read_gaps(user[GAPS]) if GAPS in user else ()
                if found.take(payload, said, self._clock_ns()):
                    for gap in gaps:
                        self._lacking(gap)
        except InputError as error:
            self.malformed += 1
            if topic not in self._complained and len(self._complained) < TOPICS_MAX:
                self._complained.add(topic)
                log.warning("topic %s: %s", topic, error)

    def _learn(self, name: str, type_name: str, payload: bytes) -> None:
        """An agent says what the messages of its topic are; it cannot speak for other types."""
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
        found = self._inputs.get(name)
        if found is None and len(self._inputs) < TOPICS_MAX:
            settings = self._settings_of(name)
            if settings is not None:
                found = self._inputs[name] = self._make_input(settings)
        return found

    def _make_input(self, settings: TopicSettings) -> MqttInput:
        return MqttInput(settings.type, settings.depth, self._forget)

    def _forget(self, closed: MqttInput) -> None:
        """It is found again by what comes next."""
        self._inputs = {name: one for name, one in self._inputs.items() if one is not closed}

    def _settings_of(self, name: str) -> TopicSettings | None:
        return next((one for one in self._followed if one.pattern.agent(name) is not None), None)


class MqttReactions:
    """An MQTT reaction (port Reaction); all methods belong to the receiving thread."""

    def __init__(
        self,
        settings: MqttReaction,
        broker: Broker,
        box: DeadLetterBox,
        clock: Callable[[], float],
        kept: Kept | None = None,
    ) -> None:
        self.name, self.retry_seconds = settings.name, settings.retry_seconds
        self._settings, self._broker, self._box, self._clock = settings, broker, box, clock
        self.delivered = self.retries = self.dead = 0
        self._kept, self._new = kept or Kept(), deque[Delivery]()
        self._waits_until = clock() + OPEN_SECONDS_MAX
        self._stopped = False
        broker.listen(self)

    @property
    def unreachable(self) -> str:
        """See the port."""
        return self._broker.unreachable

    def react(self, delivery: Delivery) -> None:
        """See the port."""
        self._kept.add(delivery)
        if len(self._new) < QUEUE_MAX:
            self._new.append(delivery)
            self.hand_over(self._clock())
        else:
            self.give_up(delivery, f"{QUEUE_MAX} messages wait for the broker already")

    def hand_over(self, now: float) -> None:
        """Give the broker what is new, behind what an earlier process has left."""
        if not self._kept.settled and now < self._waits_until:
            return
        for delivery in self._kept.left():
            self._put(delivery)
        while self._new:
            self._put(self._new.popleft())

    def _put(self, delivery: Delivery) -> None:
        properties = (
            content_type(CONTENT_TYPE) + user_property(TRACE, delivery.trace) + user_property("id", delivery.id)
        )
        retained, now = self._settings.retained, self._clock()
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
        """Whether it is stopped and has nothing to hand over."""
        return self._stopped and not self._new

    def deliver(self, delivery: Delivery) -> None:
        """The broker has it."""
        self.delivered += 1
        self._kept.done(delivery)

    def leave(self, delivery: Delivery, reason: str) -> None:
        """The time is over: to the next process, when that will find it."""
        if self._kept.outlives(delivery):
            log.warning("reaction %s: %s is left to the next process: %s", self.name, delivery.id, reason)
        else:
            self.give_up(delivery, reason)

    def give_up(self, delivery: Delivery, reason: str) -> None:
        """A dead letter."""
        self.dead += 1
        self._box.add(self.name, delivery.id, reason)
        self._kept.done(delivery)


def _any_agent(name: str) -> str:
    """An MQTT filter for a pattern's topics: the level that names the agent is any."""
    return "/".join("+" if AGENT in level else level for level in name.split("/"))
