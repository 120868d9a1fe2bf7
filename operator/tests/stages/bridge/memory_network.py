"""A ROS network and an MQTT connection in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from robotkube.errors import InputError
from robotkube.robots.bags.ports.player import PlaybackClock
from robotkube.robots.mqtt.ports import ChannelEvents
from robotkube.robots.ros.core.common_messages import PublishOutcome
from robotkube.robots.ros.core.graph import Endpoint as GraphEndpoint
from robotkube.robots.ros.ports import MessageSink


@dataclass
class Endpoint:
    """A subscription or a publisher."""

    topic: str
    waiting: list[bytes] = field(default_factory=list)
    published: list[bytes] = field(default_factory=list)
    closed: bool = False
    matched: int = 1

    def take(self, messages_max: int = 1000) -> list[bytes]:
        messages, self.waiting = self.waiting[:messages_max], self.waiting[messages_max:]
        return messages

    def publish(self, data: bytes) -> None:
        self.published.append(data)

    def close(self) -> None:
        self.closed = True


class Network:
    """Endpoints by topic; types of package `nowhere` are unknown. `signals`: how many messages pass before the next
    signal; `refused` is never taken."""

    def __init__(self, clock: PlaybackClock | None = None) -> None:
        self.clock = clock
        self.signals = list[int]()
        self.refused = b""
        self.made: list[Endpoint] = []
        self.others: list[GraphEndpoint] = []

    def endpoints(self) -> list[GraphEndpoint]:
        return self.others

    def subscribe(self, topic: str, type_name: str, *_: object, **__: object) -> Endpoint:
        if type_name.startswith("nowhere/"):
            raise InputError(f"type {type_name}: message package nowhere is not installed in this image")
        self.made.append(Endpoint(topic))
        return self.made[-1]

    advertise = subscribe

    def publish_due(self, messages: Sequence[tuple[MessageSink, int, bytes]], late_ns: int) -> PublishOutcome:
        assert self.clock is not None
        late = 0
        most = self.signals.pop(0) if self.signals else len(messages)
        for count, (sink, due, data) in enumerate(messages[:most]):
            while (left := due - self.clock.now()) > 0:
                self.clock.sleep(left)
            if data == self.refused:
                return PublishOutcome(count, late, "no room")
            late += left < -late_ns
            sink.publish(data)
        return PublishOutcome(min(most, len(messages)), late)

    def endpoint(self, topic: str) -> Endpoint:
        """The open endpoint of a topic."""
        (opened,) = [e for e in self.made if e.topic == topic and not e.closed]
        return opened


class Channel:
    """Notes its calls; the test plays the broker."""

    def __init__(self, name: str, events: ChannelEvents) -> None:
        self.name, self.events = name, events
        self.complaint: str | None = "not connected"
        self.sent: list[tuple[str, bytes, bool]] = []
        self.properties: list[bytes] = []
        self.subscribed: list[str] = []
        self.unsubscribed: list[str] = []
        self.wants_write = self.congested = self.closed = False

    def connect(self, session_kept: bool = False) -> None:
        """The broker takes the connection."""
        self.complaint = None
        self.events.connected(session_kept)

    def lose(self) -> None:
        """The connection breaks."""
        self.complaint = "lost"
        self.events.disconnected()

    def acknowledge(self, token: int, heard: bool = True) -> None:
        """The broker has the batch."""
        self.events.acknowledged(token, heard)

    def turn(self, now: float) -> None: ...

    def flush(self) -> None: ...

    def reject(self, token: int) -> None:
        """The broker does not accept the batch."""
        self.events.rejected(token, "not authorised")

    def publish(self, topic: str, payload: bytes, retained: bool, properties: bytes = b"") -> int | None:
        self.properties.append(properties)
        self.sent.append((topic, payload, retained))
        return len(self.sent)

    def subscribe(self, topics: Sequence[str]) -> None:
        self.subscribed += topics if self.complaint is None else []

    def unsubscribe(self, topics: Sequence[str]) -> None:
        self.unsubscribed += topics if self.complaint is None else []

    def close(self) -> None:
        self.closed = True
