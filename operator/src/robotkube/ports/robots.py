"""Robots' data: live topics, the ROS network of a node, MQTT connections, bags and ledgers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from robotkube.domain.bags import BagTopic, LedgerState
from robotkube.domain.detector_settings import TopicSettings
from robotkube.domain.interface_checks import Endpoint
from robotkube.domain.messages import Published
from robotkube.domain.qualities import Broken, Incompatible, Offer, Quality


class TopicInput(Protocol):
    """One subscription."""

    @property
    def lost(self) -> int:
        """Messages that were dropped before they were drained."""
        ...

    @property
    def matched(self) -> int:
        """Publishers that are connected, as far as they are known."""
        ...

    @property
    def incompatible(self) -> Incompatible:
        """The publishers that the middleware has refused to connect because of their quality of service."""
        ...

    @property
    def broken(self) -> Broken:
        """Deadlines and leases that connected publishers have not kept, of those that were asked for."""
        ...

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """What arrived since the last call, oldest first: serialised message and time of reception in ns."""
        ...

    def close(self) -> None:
        """Give the subscription back."""
        ...


class LiveTopics(Protocol):
    """Where a detector's topics come from: the ROS graph, or the broker. One thread, nothing blocks."""

    def follow(self, topics: Sequence[TopicSettings]) -> None:
        """Take note of all topics that may be asked for."""
        ...

    def subscribe(
        self, topic: str, settings: TopicSettings, quality: Quality, before: TopicInput | None = None
    ) -> TopicInput:
        """Subscribe; DocumentError when there is no such message type.

        In the place of `before`, another subscription of the topic: no message is missed in between, and what both get
        comes once. `before` belongs to the new one from now on, which closes it and counts on from its `lost`."""
        ...

    def visible(self) -> Mapping[str, Sequence[str]]:
        """Topic -> types of every topic that has a publisher or subscriber now."""
        ...

    def offers(self, topic: str) -> Sequence[Offer]:
        """The publishers of a topic that are known now."""
        ...


class SettingsReading(Protocol):
    """When a process's own settings were read. Times are seconds of one clock."""

    @property
    def read_at(self) -> float | None:
        """When the last reading began that the API server answered, None before the first. What it brought was told
        before this says so."""
        ...

    @property
    def interrupted_at(self) -> float | None:
        """Since when the API server is out of reach; None while it answers."""
        ...

    def read_again(self) -> None:
        """Read now; returns at once."""
        ...


class OwnTasks(Protocol):
    """The TaskDescriptions of a detector's own namespace. UnavailableError when the API server does not answer,
    RefusalError when it says no."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """All of them."""
        ...

    def create(self, task: Mapping[str, Any]) -> None:
        """Make the object; one of that name that is there already is success."""
        ...

    def renew(self, name: str, now: int) -> bool:
        """Renew the lease at `now` (ns since 1970); False when there is no such object."""
        ...

    def delete(self, name: str) -> None:
        """Delete the object; one that is not there is success."""
        ...


class MessageSource(Protocol):
    """A subscription that hands out serialised messages (CDR with its encapsulation)."""

    @property
    def matched(self) -> int:
        """Publishers that are connected now."""
        ...

    def take(self, messages_max: int = 1000) -> list[bytes]:
        """The messages that wait, oldest first, at most `messages_max`; never blocks."""
        ...

    def close(self) -> None:
        """Stop receiving."""
        ...


class MessageSink(Protocol):
    """A publisher of serialised messages."""

    @property
    def matched(self) -> int:
        """Subscriptions that are connected now."""
        ...

    def publish(self, data: bytes) -> None:
        """Send one message. UnavailableError when the middleware cannot take it now."""
        ...

    def close(self) -> None:
        """Stop sending."""
        ...


class RobotNetwork(Protocol):
    """The ROS network of this node; all methods belong to one thread. InputError: unknown type or bad topic name."""

    def subscribe(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> MessageSource:
        """Begin to receive a topic."""
        ...

    def advertise(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> MessageSink:
        """Begin to offer a topic."""
        ...

    def publish_due(self, messages: Sequence[tuple[MessageSink, int, bytes]], late_ns: int) -> Published:
        """Publish each at its time (ns since 1970), at once when that is past, in this order. Blocks until the last
        one, or until a signal comes: then what is left is to be asked for again."""
        ...

    def endpoints(self) -> Sequence[Endpoint]:
        """Publishers and subscriptions of all other nodes that are known now."""
        ...


class ChannelEvents(Protocol):
    """What a connection tells its owner, from within `FrameChannel.turn`."""

    def connected(self, session_kept: bool) -> None:
        """The broker took the connection; `session_kept`: it still knows this client's subscriptions."""
        ...

    def disconnected(self) -> None:
        """The connection is gone."""
        ...

    def acknowledged(self, token: int, heard: bool) -> None:
        """The broker has the frame of this token; `heard`: it has subscribers for it."""
        ...

    def rejected(self, token: int, reason: str) -> None:
        """The broker does not take the frame of this token."""
        ...

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """A frame arrived; `properties` as in the packet (domain.mqtt_properties reads them)."""
        ...

    def refused(self, topic: str, reason: str) -> None:
        """The broker refuses a subscription."""
        ...


class FrameChannel(Protocol):
    """A connection to the broker that is made, and made again, by turning it. One thread, nothing blocks."""

    @property
    def complaint(self) -> str | None:
        """None while connected, else why not."""
        ...

    def turn(self, now: float) -> None:
        """Connect when that is due, read all that arrived, write what waits. `now` in monotonic seconds."""
        ...

    def publish(self, topic: str, payload: bytes, retained: bool, properties: bytes = b"") -> int | None:
        """Hand over a frame with QoS 1 and its MQTT 5 properties (domain.mqtt_properties writes them); the token of its
        acknowledgement, or None when it was not taken."""
        ...

    def subscribe(self, topics: Sequence[str]) -> None:
        """Subscribe with QoS 1; what this connection published does not come back. Subscriptions are made anew after a
        lost connection."""
        ...

    def unsubscribe(self, topics: Sequence[str]) -> None:
        """End subscriptions."""
        ...

    def flush(self) -> None:
        """Write what `publish`, `subscribe` and `unsubscribe` left, as far as the network takes it."""
        ...

    def close(self) -> None:
        """Say good-bye."""
        ...


class Bag(Protocol):
    """Recorded messages with times from the start of the run."""

    @property
    def topics(self) -> Sequence[BagTopic]:
        """The topics in the bag."""
        ...

    def messages(self) -> Iterable[tuple[str, int, bytes]]:
        """Topic, offset in ns and serialised message, offsets ascending. InputError where the bag is damaged."""
        ...


class Ledgers(Protocol):
    """One append-only ledger per run and topic."""

    def open(self, run: str, topic: str) -> LedgerState:
        """Open for appending; what is there already. A torn last line is cut off. InputError when it cannot be."""
        ...

    def append(self, topic: str, line: str) -> None:
        """Add a line to the open ledger of the topic; kept in memory until `flush`."""
        ...

    def flush(self) -> None:
        """Write what was appended."""
        ...

    def close(self) -> None:
        """Flush and close all ledgers of the run."""
        ...


class Clock(Protocol):
    """The shared clock of all players."""

    def now(self) -> int:
        """Time in ns since 1970."""
        ...

    def sleep(self, nanoseconds: int) -> None:
        """Return after that time, or earlier."""
        ...
