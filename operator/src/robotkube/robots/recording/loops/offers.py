"""Messages on their way through a recorder: offered, chosen for a segment, being appended."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from robotkube.errors import InputError
from robotkube.robots.recording.core.documents import (
    AUDITS,
    DOCUMENT_BYTES_MAX,
    INDEX,
    MANIFESTS,
    RECORDINGS,
    SAMPLES,
    SEGMENT,
    Received,
    SegmentPlace,
)
from robotkube.robots.recording.core.writer_notes import WriterNotes
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
        """Return whether it belongs into a segment."""
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
    """What the database has of earlier recorders of the same recording: collection and document, samples without data.
    `notes`: life -> what they had noted on this recorder's volume before that was read."""

    documents: Sequence[tuple[str, Mapping[str, Any]]]
    notes: Mapping[int, WriterNotes]

    @property
    def recording(self) -> Mapping[str, Any]:
        """The recording's own document; empty when there is none."""
        return next(iter(self._of(RECORDINGS)), {})

    @property
    def audits(self) -> list[Mapping[str, Any]]:
        """The audits."""
        return self._of(AUDITS)

    @property
    def manifests(self) -> list[Mapping[str, Any]]:
        """The manifests and their parts."""
        return self._of(MANIFESTS)

    @property
    def stored(self) -> list[tuple[str, Mapping[str, Any]]]:
        """What belongs into a manifest."""
        return [(name, document) for name, document in self.documents if name not in (RECORDINGS, MANIFESTS)]

    def messages(self) -> Iterator[tuple[str, int, str]]:
        """Topic, stamp and SHA-256 of every message."""
        for bucket in self._of(SAMPLES):
            for sample in bucket["samples"]:
                yield bucket["topic"], sample["stamp"], sample["sha256"]
        for entry in self._of(INDEX):
            yield entry["topic"], entry["stamp"], entry["sha256"]

    def refuse_another_task(self, document: Mapping[str, Any]) -> None:
        """Refuse, with an InputError, to go on with what another task than this `document`'s began: it would be two
        recordings in one."""
        own, earlier = ((one.get("provenance") or {}).get("task") for one in (document, self.recording))
        if own and earlier and own != earlier:
            raise InputError(
                f"task {earlier} began it, and this recorder's task is {own}; name the reaction's `recording` after "
                "namespace and task, as {{ task.namespace }}.{{ task.name }}"
            )

    def _of(self, collection: str) -> list[Mapping[str, Any]]:
        return [document for name, document in self.documents if name == collection]


def digest_of(data: bytes) -> str:
    """SHA-256 of a message, hex."""
    return hashlib.sha256(data).hexdigest()
