"""The ROS network of a node: subscriptions and publishers of serialised messages, and the graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from robotkube.robots.ros.core.common_messages import PublishOutcome
from robotkube.robots.ros.core.graph import Endpoint


class MessageSource(Protocol):
    """A subscription that gives serialised messages (CDR with its encapsulation)."""

    @property
    def matched(self) -> int:
        """The number of publishers that are connected now."""
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
        """The number of subscriptions that are connected now."""
        ...

    def publish(self, data: bytes) -> None:
        """Send one message. UnavailableError when the middleware cannot accept it now."""
        ...

    def close(self) -> None:
        """Stop sending."""
        ...


class RobotNetwork(Protocol):
    """The ROS network of this node; all methods belong to one thread. InputError: unknown type or bad topic name."""

    def subscribe(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> MessageSource:
        """Subscribe to a topic."""
        ...

    def advertise(
        self, topic: str, type_name: str, reliability: str = "reliable", durability: str = "volatile", depth: int = 1000
    ) -> MessageSink:
        """Create a publisher of a topic."""
        ...

    def publish_due(self, messages: Sequence[tuple[MessageSink, int, bytes]], late_ns: int) -> PublishOutcome:
        """Publish each message at its time (ns since 1970), at once when that is past, in this order.

        Blocks until the last one, or until a signal comes: then the caller publishes the rest with another call."""
        ...

    def endpoints(self) -> Sequence[Endpoint]:
        """The publishers and subscriptions of all other nodes that are known now."""
        ...
