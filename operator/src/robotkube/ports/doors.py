"""The broker as the task door sees it, and the tasks that the door writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class DoorMessage:
    """One message of an operator. `payload` is empty when `size` (bytes) is more than a task may have; `token` is what
    its acknowledgement needs."""

    topic: str
    payload: bytes
    size: int
    token: Any = None


class DoorChannel(Protocol):
    """A session at the broker that outlives the process: what is not acknowledged comes again."""

    @property
    def complaint(self) -> str:
        """Empty while connected and subscribed, else why not."""
        ...

    def start(self, topics: Sequence[str]) -> None:
        """Connect, now and after every loss, and hear exactly these topics."""
        ...

    def take(self, seconds: float) -> DoorMessage | None:
        """The next message, oldest first; None when none came within the time."""
        ...

    def acknowledge(self, message: DoorMessage) -> None:
        """The message is done with; one of a connection that was lost comes again all the same."""
        ...

    def leave(self, message: DoorMessage) -> None:
        """The message cannot be done with now: it comes again, and those behind it, on a connection of its own."""
        ...

    def publish(self, topic: str, payload: bytes) -> bool:
        """Hand an answer over (QoS 1); False when there is no connection or too many wait."""
        ...

    def close(self) -> None:
        """Part from the broker; the session stays there."""
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
