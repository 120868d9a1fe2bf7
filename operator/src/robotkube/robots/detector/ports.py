"""Live topics: the sources of a detector's messages, and subscriptions to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from robotkube.robots.detector.core.settings import TopicSettings
from robotkube.robots.ros.core.qos import IncompatiblePublishers, PublisherOffer, QosProfile, QosViolations


class TopicInput(Protocol):
    """A subscription to a topic."""

    @property
    def lost(self) -> int:
        """The number of messages that were dropped before they were drained."""
        ...

    @property
    def matched(self) -> int:
        """The number of publishers that are connected, as far as they are known."""
        ...

    @property
    def incompatible(self) -> IncompatiblePublishers:
        """The publishers that the middleware has refused to connect because of their quality of service."""
        ...

    @property
    def violations(self) -> QosViolations:
        """The requested deadlines and leases that connected publishers have not kept."""
        ...

    def drain(self, messages_max: int) -> Sequence[tuple[bytes, int]]:
        """The messages since the last call, oldest first: serialised message and time of reception in ns."""
        ...

    def close(self) -> None:
        """End the subscription."""
        ...


class LiveTopics(Protocol):
    """A source of a detector's topics: the ROS graph, or the broker. One thread, nothing blocks."""

    def announce(self, topics: Sequence[TopicSettings]) -> None:
        """Announce all topics that may be subscribed to."""
        ...

    def subscribe(
        self, topic: str, settings: TopicSettings, qos: QosProfile, before: TopicInput | None = None
    ) -> TopicInput:
        """Subscribe to a topic; DocumentError when there is no such message type.

        The subscription may take the place of `before`, another one of the topic: no message is missed in between, and
        one that both get comes once. `before` belongs to the new one from now on, which closes it and counts on from
        its `lost`."""
        ...

    def visible(self) -> Mapping[str, Sequence[str]]:
        """The types of every topic that has a publisher or subscriber now, by topic."""
        ...

    def offers(self, topic: str) -> Sequence[PublisherOffer]:
        """The publishers of a topic that are known now."""
        ...
