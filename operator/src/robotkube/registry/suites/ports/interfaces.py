"""Ports of the interface suite's observer: a node's ROS graph, a broker, a database."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from robotkube.registry.catalogue.core.expected_topics import ExpectedTopic
from robotkube.robots.ros.core.graph import Endpoint
from robotkube.robots.ros.ports import RobotNetwork


class ObservedNetwork(RobotNetwork, Protocol):
    """The ROS network of the node."""

    def endpoints(self) -> Sequence[Endpoint]:
        """Publishers and subscriptions of everybody else, as far as they are known now."""
        ...


@dataclass(frozen=True)
class BrokerMessage:
    """A message as its publisher sent it."""

    topic: str
    payload: bytes
    qos: int
    retain: bool


class ObservedBroker(Protocol):
    """A connection that receives everything that others publish."""

    def receive(self) -> Sequence[BrokerMessage]:
        """The messages since the last call; never blocks."""
        ...

    def publish(self, message: BrokerMessage) -> None:
        """Send a message, which does not come back."""
        ...


class ObservedDatabase(Protocol):
    """The test namespace's database; UnavailableError when it does not answer."""

    def counts(self) -> Mapping[str, int]:
        """Collection -> number of its documents."""
        ...

    def put(self, collection: str) -> None:
        """Write a document."""
        ...

    def clear(self) -> None:
        """Delete all collections."""
        ...


class Messages(Protocol):
    """Messages without meaning."""

    def payload(self, topic: ExpectedTopic) -> bytes:
        """A new one for a topic (ROS: serialised; MQTT: as its encoding says); InputError for an unknown type."""
        ...

    def type_mismatch(self, type_name: str, data: bytes) -> str:
        """Why a serialised message is not of the type; empty when it is."""
        ...
