"""The broker as the task gateway sees it, and the tasks that the gateway writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class GatewayMessage:
    """One message of an operator. `payload` is empty when `size` (bytes) is more than a task may have; `token` is what
    its acknowledgement needs."""

    topic: str
    payload: bytes
    size: int
    token: Any = None


class GatewayChannel(Protocol):
    """A session at the broker that outlives the process: what is not acknowledged comes again."""

    @property
    def complaint(self) -> str:
        """The reason why there is no session; empty while connected and subscribed."""
        ...

    def start(self, topics: Sequence[str]) -> None:
        """Connect, now and after every loss, and subscribe to exactly these topics."""
        ...

    def receive(self, seconds: float) -> GatewayMessage | None:
        """Receive the next message, oldest first; None when none came within the time."""
        ...

    def acknowledge(self, message: GatewayMessage) -> None:
        """Acknowledge a message that is done with; one of a connection that was lost comes again all the same."""
        ...

    def leave(self, message: GatewayMessage) -> None:
        """Leave a message that cannot be done with now: it comes again, and those behind it, on another connection."""
        ...

    def publish(self, topic: str, payload: bytes) -> bool:
        """Send an answer (QoS 1); False when there is no connection or too many wait."""
        ...

    def close(self) -> None:
        """End the connection; the session stays at the broker."""
        ...


class TaskWriter(Protocol):
    """Writing of TaskDescriptions. UnavailableError: the API server does not answer now; InputError: it refuses."""

    def find(self, namespace: str, name: str) -> Mapping[str, Any] | None:
        """The object as the API server holds it now; None when there is none."""
        ...

    def create(self, document: Mapping[str, Any]) -> bool:
        """Make the object; False when one of that name is there already."""
        ...

    def patch_spec(self, namespace: str, name: str, spec: Mapping[str, Any]) -> bool:
        """Put `spec` in place of the present one; equal to it, nothing changes. False when there is no such task."""
        ...

    def annotate(self, namespace: str, name: str, annotations: Mapping[str, str]) -> bool:
        """Set metadata that are no part of the demand; False when there is no such task."""
        ...

    def delete(self, namespace: str, name: str) -> bool:
        """Withdraw the demand; False when there was no such task."""
        ...
