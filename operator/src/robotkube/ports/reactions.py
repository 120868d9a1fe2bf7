"""Reactions: what is done about the edges of events, somewhere else and in its own time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol


class Delivery(NamedTuple):
    """An edge on its way to somebody. `id`: the same for the same edge, so that a receiver can tell a repetition;
    `body`: the edge as JSON (docs/reference/event-detector.md)."""

    id: str
    edge: str
    trace: str
    body: bytes


class KeptDelivery(NamedTuple):
    """A delivery as it is kept on a disk. `reaction`: whom it is for, by a key that is the same after a restart;
    `name`: what status calls that reaction; `time`: when it was raised, ns since 1970."""

    reaction: str
    name: str
    time: int
    delivery: Delivery


class DeadLetter(NamedTuple):
    """An edge that a reaction has given up. `time`: when, ns since 1970; `reason`: why, in words."""

    reaction: str
    id: str
    time: int
    reason: str

    def document(self) -> dict[str, Any]:
        """As JSON values."""
        return {"reaction": self.reaction, "id": self.id, "time": self.time, "reason": self.reason}


class DeliveryLog(Protocol):
    """Deliveries that wait, on a disk; for one thread. Every method but `close` may raise OSError: the disk refuses."""

    size: int
    """Bytes that it takes."""

    def open(self) -> Sequence[KeptDelivery]:
        """Make it ready to be written; returns what an earlier process has left, oldest first."""
        ...

    def write(self, added: Sequence[KeptDelivery], removed: Sequence[tuple[str, str]]) -> None:
        """First forget what was removed (reaction, id), then keep what was added; returns when that is on the disk.
        After an OSError nobody knows what is; it may be written again."""
        ...

    def replace(self, entries: Sequence[KeptDelivery]) -> None:
        """Keep these and nothing else. After an OSError the former are there, or these."""
        ...

    def close(self) -> None:
        """Give it back."""
        ...


class Sender(Protocol):
    """Takes deliveries to one receiver. Used by one thread, which may be held up for as long as the sender's bound."""

    def probe(self) -> None:
        """Returns when the receiver is within reach; UnavailableError when it is not."""
        ...

    def send(self, delivery: Delivery) -> None:
        """Returns when the receiver has it. UnavailableError: try again; any other RobotKubeError: never will."""
        ...

    def close(self) -> None:
        """Give connections and processes back."""
        ...


class Reaction(Protocol):
    """What a detector does about the edges of a rule, besides tasks and recordings."""

    @property
    def name(self) -> str:
        """What status and metrics call it."""
        ...

    @property
    def unreachable(self) -> str:
        """Why its target cannot be reached, in words; empty when it can."""
        ...

    def react(self, delivery: Delivery) -> None:
        """Have an edge delivered; never blocks."""
        ...

    def counts(self) -> Mapping[str, int]:
        """`delivered`, `retries`, `dead` only grow; `waiting` is how many are under way."""
        ...

    def stop(self, seconds: float) -> bool:
        """Deliver what waits within `seconds`; True when nothing is left. What is left becomes a dead letter."""
        ...


class Spans(Protocol):
    """Where spans of OpenTelemetry go. Calls return at once and never raise."""

    def span(self, trace: str, name: str, begin: int, end: int, attributes: Mapping[str, str]) -> None:
        """A piece of work in a trace (32 hexadecimal digits), from `begin` to `end` (ns since 1970)."""
        ...

    def close(self) -> None:
        """Send what waits, within a bound."""
        ...
