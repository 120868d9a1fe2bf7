"""Messages on their way through a recorder: offered, chosen for a segment, being appended."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from robotkube.robots.recording.core.documents import DOCUMENT_BYTES_MAX, SEGMENT, Received, SegmentPlace
from robotkube.robots.recording.loops.recording_audits import Arrival
from robotkube.robots.recording.ports import Segments

arrival: Callable[[Offer], Arrival] = attrgetter("topic", "stamp")
"""Topic and stamp of an offered message."""


@dataclass(frozen=True, slots=True)
class Offer:
    """A message as it was offered to a recorder."""

    topic: str
    type: str
    storage: str
    stamp: int
    received: int
    data: bytes

    @property
    def large(self) -> bool:
        """True when it belongs into a segment."""
        return self.storage == SEGMENT or len(self.data) > DOCUMENT_BYTES_MAX


@dataclass(slots=True)
class LargeMessage:
    """A message for a segment. `admitted`: it is known to be no duplicate, and remembered."""

    offer: Offer
    digest: Future[str]
    admitted: bool = False

    def message(self) -> tuple[Received, str]:
        """The message and its type as a segment stores them, without digest."""
        return Received(self.offer.topic, self.offer.stamp, self.offer.received, "", self.offer.data), self.offer.type


@dataclass(frozen=True, slots=True)
class PendingAppend:
    """Messages on their way to a segment."""

    segments: Segments
    chosen: Sequence[LargeMessage]
    places: Future[Sequence[SegmentPlace | None]]


@dataclass(frozen=True, slots=True)
class PriorContents:
    """Messages and audits that the database has of an earlier recorder of the same recording."""

    messages: Sequence[tuple[str, int, str]]
    audits: Sequence[Mapping[str, Any]]


def digest_of(data: bytes) -> str:
    """SHA-256 of a message, hex."""
    return hashlib.sha256(data).hexdigest()
