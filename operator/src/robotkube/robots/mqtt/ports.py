"""A connection to the MQTT broker, and the events that it reports to its owner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class ChannelEvents(Protocol):
    """The events that a connection reports to its owner, from within `MqttChannel.turn`."""

    def connected(self, session_kept: bool) -> None:
        """The broker accepted the connection; `session_kept`: it still knows this client's subscriptions."""
        ...

    def disconnected(self) -> None:
        """The connection is gone."""
        ...

    def acknowledged(self, token: int, heard: bool) -> None:
        """The broker has the message of this token; `heard`: it has subscribers for it."""
        ...

    def rejected(self, token: int, reason: str) -> None:
        """The broker refuses the message of this token."""
        ...

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        """A message arrived; `properties` as in the packet (core.properties reads them)."""
        ...

    def refused(self, topic: str, reason: str) -> None:
        """The broker refuses a subscription. It is asked for again after a pause, until it is granted or ended."""
        ...

    def granted(self, topic: str) -> None:
        """The broker takes a subscription that it had refused on this connection."""
        ...


class MqttChannel(Protocol):
    """A connection to the broker that is made, and made again, by turning it. One thread, nothing blocks."""

    @property
    def complaint(self) -> str | None:
        """The reason why there is no connection; None while there is one."""
        ...

    @property
    def wants_write(self) -> bool:
        """Return whether something waits that the socket did not take."""
        ...

    @property
    def congested(self) -> bool:
        """Return whether something waits that did not leave the machine: in front of the socket, or in it."""
        ...

    def turn(self, now: float) -> None:
        """Connect when that is due, read all that arrived, write what waits. `now` in monotonic seconds."""
        ...

    def publish(self, topic: str, payload: bytes, retained: bool, properties: bytes = b"") -> int | None:
        """Send a message with QoS 1 and its MQTT 5 properties (core.properties writes them); returns the token of its
        acknowledgement, or None when it was not accepted."""
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
        """Disconnect; waits a moment, in milliseconds as a rule, until the broker has read what was sent."""
        ...
