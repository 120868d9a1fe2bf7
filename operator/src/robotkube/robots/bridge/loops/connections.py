"""One connection of a bridge to the broker, with what it carries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robotkube.errors import InputError
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.bridge.core import mqtt_client_format
from robotkube.robots.bridge.core.outbox import Outbox, OutboxBounds
from robotkube.robots.bridge.core.settings import BULK, MQTT_CLIENT, SAFETY, TELEMETRY, BridgedTopic
from robotkube.robots.bridge.core.waiting_batches import OutgoingBatch
from robotkube.robots.bridge.loops.flows import Incoming
from robotkube.robots.mqtt.core.message_properties import gaps_property
from robotkube.robots.ros.core.gaps import Gap

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.robots.mqtt.ports import ChannelEvents, MqttChannel

    MakeChannel = Callable[[str, str, ChannelEvents], MqttChannel]

MIB = 1024 * 1024
BOUNDS = {
    SAFETY: OutboxBounds(seconds_max=2.0, batches_max=2_000, bytes_max=8 * MIB, inflight_max=50),
    TELEMETRY: OutboxBounds(seconds_max=60.0, batches_max=60_000, bytes_max=96 * MIB, inflight_max=200),
    BULK: OutboxBounds(seconds_max=2.0, batches_max=10, bytes_max=48 * MIB, inflight_max=4, thinned=True),
}
HANDED_BYTES_MAX = 64 * 1024
"""What a connection is given at once; then it is looked at whether the socket took it."""
REFUSALS_MAX = 50

Log = Callable[..., None]
OpenIncoming = Callable[[BridgedTopic, str], Incoming | None]
"""Opens the one topic of an agent, by a general topic and the MQTT topic of a message that came for it; or None."""


@dataclass
class SendPause:
    """The pause of sending between a connection made anew and settings read since then."""

    fencing: Fencing
    held: bool = False

    def interrupted(self) -> None:
        """Pause, for a connection was made anew, unless the settings were read a moment ago."""
        self.fencing.interrupted()
        self.held = self.held or self.fencing.fenced


class BrokerConnection:
    """One connection to the broker, and its events. `opened` makes the topics that general ones discover; nothing
    leaves while `pause` holds it."""

    def __init__(
        self,
        name: str,
        agent: str,
        make: MakeChannel,
        log: Log,
        clock: Callable[[], int],
        opened: OpenIncoming,
        pause: SendPause,
    ) -> None:
        self.name = name
        self._pause = pause
        self.outbox = Outbox(BOUNDS[name], f"mqtt-bridge of {agent}")
        self.incoming: dict[str, Incoming] = {}
        self.general: dict[str, BridgedTopic] = {}
        self.filters: tuple[str, ...] = ()
        self.retained: dict[str, OutgoingBatch] = {}
        self.refused_batches = 0
        self.connections = 0
        self.refusals: dict[str, str] = {}
        self._sending: set[str] = set()
        self._log = log
        self._clock = clock
        self._opened = opened
        self._now = 0.0
        self.channel = make(agent, name, self)
        self._logged = self.channel.complaint

    def add(self, topic: BridgedTopic, incoming: Incoming | None) -> None:
        """Bring in a topic (with its publisher), or every one that a general topic stands for."""
        if incoming is None:
            self.general[topic.name] = topic
        else:
            self.incoming[topic.mqtt] = incoming
        self._subscribe()

    def remove(self, topic: BridgedTopic) -> None:
        """Do not bring in a topic any more."""
        if topic.general:
            self.general.pop(topic.name, None)
        else:
            self.incoming.pop(topic.mqtt, None)
        self._subscribe()

    def _subscribe(self) -> None:
        """Change the subscriptions; what stays, and what takes another's place, has no gap."""
        before = self.filters
        self.filters = tuple(dict.fromkeys(self._wanted()))
        ended = [name for name in before if name not in self.filters]
        self.channel.subscribe([name for name in self.filters if name not in before])
        self.channel.unsubscribe(ended)
        for name in ended:
            self._forget_refusal(name)

    def _wanted(self) -> Iterator[str]:
        """The filters to subscribe to: nothing twice, so that nothing comes twice."""
        general = tuple(self.general.values())
        for topic in general:
            yield from _filters(topic)
        for incoming in self.incoming.values():
            if not any(topic.agent(incoming.topic.name) for topic in general):
                yield from _filters(incoming.topic)
            if incoming.announced:
                yield incoming.topic.mqtt

    def put(self, batch: OutgoingBatch) -> None:
        """Send a batch when its turn comes."""
        self._sending.add(batch.topic)
        self.outbox.put(batch)
        if batch.retained:
            self.retained[batch.topic] = batch

    def withdraw(self, topic: str) -> None:
        """Forget an MQTT topic, also at the broker, unless it may be somebody else's by now."""
        self._sending.discard(topic)
        self._forget_refusal(topic)
        self.outbox.forget(topic)
        if self.retained.pop(topic, None) is not None and not self._pause.held:
            self.outbox.put(OutgoingBatch(topic, b"", 0, True, self._now))

    def connected(self, session_kept: bool) -> None:
        """Subscribe anew; a broker without a session of ours has lost what it retained, too."""
        self.connections += 1
        if self.connections > 1:
            self._pause.interrupted()
        self.refusals.clear()
        self._log("connected", channel=self.name, session_kept=session_kept)
        self.channel.subscribe(self.filters)
        self.outbox.connected(self._now)
        if not session_kept:
            waiting = {(batch.topic, batch.payload) for batch in self.outbox.waiting}
            for batch in self.retained.values():
                if (batch.topic, batch.payload) not in waiting:
                    self.outbox.put(batch)

    def disconnected(self) -> None:
        """Let what was on its way wait again."""
        self._logged = self.channel.complaint
        self._log("disconnected", channel=self.name, reason=self._logged)
        self.outbox.disconnected(self._now)

    def acknowledged(self, token: int, heard: bool) -> None:
        """Remove an acknowledged batch from the outbox."""
        self._log_dropped(self.outbox.acknowledged(token, heard, self._now))

    def rejected(self, token: int, reason: str) -> None:
        """Give up a batch that the broker does not accept."""
        batch = self.outbox.rejected(token)
        if batch is not None:
            self.refused(batch.topic, reason)

    def refused(self, topic: str, reason: str) -> None:
        """Keep a refusal of the broker until the next connection, until it is granted, or until the topic is closed:
        what is answered after that is only logged."""
        if topic not in self.refusals:
            if len(self.refusals) >= REFUSALS_MAX:
                return
            self._log("refused by the broker", channel=self.name, topic=topic, reason=reason)
        if topic in self._sending or topic in self.filters:
            self.refusals[topic] = f"{topic}: {reason}"

    def granted(self, topic: str) -> None:
        """Forget a refusal: the right came later than the subscription."""
        if self.refusals.pop(topic, None) is not None:
            self._log("granted by the broker", channel=self.name, topic=topic)

    def _forget_refusal(self, topic: str) -> None:
        if topic not in self._sending and topic not in self.filters:
            self.refusals.pop(topic, None)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """Publish a message's content, unless it was here before."""
        incoming = self.incoming.get(topic)
        if incoming is None:
            incoming = self._find(topic, payload)
        if incoming is None or not payload:
            return  # a retained batch was withdrawn, or it is for nobody here
        try:
            incoming.receive(payload, properties, self._clock())
        except InputError as error:
            self.count_refused(topic, str(error))

    def count_refused(self, topic: str, error: str) -> None:
        """Count a payload that cannot be carried; only the first one is logged."""
        self.refused_batches += 1
        if self.refused_batches == 1:
            self._log("batch refused", topic=topic, error=error)

    def turn(self, now: float, yields: bool = False) -> None:
        """Read, then send as much as outbox and network allow, then write. All events come within a turn. With `yields`
        nothing new is begun: what is more urgent waits on another connection."""
        self._now = now
        full = self.channel.wants_write
        self.channel.turn(now)
        self._log_complaint()
        if full:
            self.channel.flush()
            full = self.channel.wants_write
        if self.channel.complaint is None and not self._pause.held and not full and not yields:
            self._send(now)
        self.channel.flush()
        for incoming in self.incoming.values():
            if incoming.holding:
                incoming.turn(self._clock())

    def close(self) -> None:
        """Send what the connection accepts at once, then leave the broker."""
        self.turn(self._now)
        self.channel.close()
        self._log_dropped(self.outbox.unreported)

    def _log_complaint(self) -> None:
        """Log why there is no connection, once for each reason."""
        complaint = self.channel.complaint
        if complaint is not None and complaint != self._logged:
            self._log("not connected", channel=self.name, reason=complaint)
        self._logged = complaint

    def _send(self, now: float) -> None:
        """Give batches to the connection until it takes no more: what it has cannot be ordered or dropped any more."""
        handed = 0
        while (batch := self.outbox.next(now)) is not None:
            properties = batch.properties + gaps_property(batch.gaps)
            token = self.channel.publish(batch.topic, batch.payload, batch.retained, properties)
            if token is None:
                self.outbox.give_back(batch)
                return
            self.outbox.sent(token, batch)
            handed += len(batch.payload)
            if handed >= HANDED_BYTES_MAX:
                handed = 0
                self.channel.flush()
                if self.channel.wants_write:
                    return

    def _log_dropped(self, gaps: Iterable[Gap]) -> None:
        for gap in gaps:
            self._log("messages dropped", channel=self.name, topic=gap.topic, **gap.document())

    def _find(self, topic: str, payload: bytes) -> Incoming | None:
        """The topic for a message whose MQTT topic is not known by name, opened when it is a general one's."""
        typed = topic.startswith(mqtt_client_format.TYPE_PREFIX)
        name = topic.removeprefix(mqtt_client_format.TYPE_PREFIX) if typed else topic
        incoming = self.incoming.get(name) or self._open(name)
        if typed and incoming is not None and incoming.topic.format == MQTT_CLIENT:
            self._announce(incoming, payload)
        elif incoming is None and not any(_fits(mqtt_filter, topic) for mqtt_filter in self.filters):
            kept = self.filters  # a session of the broker that is older than our settings
            self.channel.unsubscribe([mqtt_filter for mqtt_filter in _wider(topic) if mqtt_filter not in kept])
        return None if typed else incoming

    def _open(self, topic: str) -> Incoming | None:
        for general in self.general.values():
            if _fits(general.filter, topic) and (incoming := self._opened(general, topic)) is not None:
                self.incoming[topic] = incoming
                return incoming
        return None

    def _announce(self, incoming: Incoming, payload: bytes) -> None:
        """Note the type of mqtt_client's messages, which it announces before each of them; then subscribe to them."""
        before = incoming.announced
        try:
            if payload:
                incoming.announce(mqtt_client_format.decode_type(payload))
        except InputError as error:
            self.count_refused(incoming.topic.mqtt, str(error))
        if incoming.announced != before:
            self._subscribe()


def _filters(topic: BridgedTopic) -> Iterator[str]:
    """The filters to subscribe to at once: of mqtt_client those of the types, needed to read the messages."""
    yield mqtt_client_format.type_topic(topic.filter) if topic.format == MQTT_CLIENT else topic.filter


def _fits(mqtt_filter: str, topic: str) -> bool:
    levels = topic.split("/")
    wanted = mqtt_filter.split("/")
    return len(levels) == len(wanted) and all(a in ("+", b) for a, b in zip(wanted, levels, strict=True))


def _wider(topic: str) -> Iterator[str]:
    """The filters of bridges that this topic fits."""
    yield topic
    levels = topic.split("/")
    for place in range(len(levels)):
        yield "/".join([*levels[:place], "+", *levels[place + 1 :]])
