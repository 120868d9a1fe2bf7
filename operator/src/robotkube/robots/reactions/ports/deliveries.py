"""Deliveries of edges to reactions, which work elsewhere and in their own time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol


class EdgeDelivery(NamedTuple):
    """An edge on its way to a receiver. `id`: the same for the same edge, so that a receiver can see a repetition;
    `body`: the edge as JSON (docs/reference/event-detector.md)."""

    id: str
    edge: str
    trace: str
    body: bytes


class JournalEntry(NamedTuple):
    """A delivery in the journal. `reaction`: a key of its reaction that is the same after a restart; `name`: that
    reaction's name in status; `time`: when it was added, ns since 1970."""

    reaction: str
    name: str
    time: int
    delivery: EdgeDelivery


class DeadLetter(NamedTuple):
    """An edge that a reaction has given up. `time`: when, ns since 1970; `reason`: why, in words."""

    reaction: str
    id: str
    time: int
    reason: str

    def document(self) -> dict[str, Any]:
        """The dead letter as JSON values."""
        return {"reaction": self.reaction, "id": self.id, "time": self.time, "reason": self.reason}


class DeliveryLog(Protocol):
    """A log of deliveries that wait, on a disk; for one thread. Every method but `close` may raise OSError."""

    size: int
    """Bytes of the log on the disk."""

    def open(self) -> Sequence[JournalEntry]:
        """Open the log for writing; returns the deliveries that an earlier process has left, oldest first."""
        ...

    def write(self, added: Sequence[JournalEntry], removed: Sequence[tuple[str, str]]) -> None:
        """Write first removals (reaction, id), then additions; returns when the additions are on the disk.

        After an OSError it is unknown what was written; it may be written again."""
        ...

    def replace(self, entries: Sequence[JournalEntry]) -> None:
        """Replace the log by these entries. After an OSError the former are there, or these."""
        ...

    def close(self) -> None:
        """Close the log, so that another process can open it."""
        ...


class DeliverySender(Protocol):
    """Sends deliveries to one receiver. Used by one thread, which it may block for as long as its bound."""

    def probe(self) -> None:
        """Check that the receiver is within reach; UnavailableError when it is not."""
        ...

    def send(self, delivery: EdgeDelivery) -> None:
        """Send a delivery; returns when the receiver has it. UnavailableError: try again; any other RobotKubeError: do
        not."""
        ...

    def close(self) -> None:
        """Close connections and end processes."""
        ...


class RunningReaction(Protocol):
    """A reaction to the edges of a rule that delivers them, unlike tasks and recordings."""

    @property
    def name(self) -> str:
        """The name in status and metrics."""
        ...

    @property
    def unreachable(self) -> str:
        """The reason why its target cannot be reached, in words; empty when it can."""
        ...

    def react(self, delivery: EdgeDelivery) -> None:
        """Queue an edge for delivery; never blocks."""
        ...

    def counts(self) -> Mapping[str, int]:
        """The counters: `delivered`, `retries` and `dead` only grow; `waiting` is the number under way."""
        ...

    def stop(self, seconds: float) -> bool:
        """Deliver what waits within `seconds`; True when nothing is left. What is left becomes a dead letter."""
        ...


class Spans(Protocol):
    """A sink of OpenTelemetry spans. Calls return at once and never raise."""

    def span(self, trace: str, name: str, begin: int, end: int, attributes: Mapping[str, str]) -> None:
        """Add a span to a trace (32 hexadecimal digits), from `begin` to `end` (ns since 1970)."""
        ...

    def close(self) -> None:
        """Send the spans that wait, within a bound."""
        ...
