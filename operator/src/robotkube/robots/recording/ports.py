"""The storage of recordings: database, segments on the volume claim, spool."""

from __future__ import annotations

import errno
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.robots.recording.core.documents import ClosedSegment, Received, SegmentMessage, SegmentPlace, Write

NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""`errno` of an OSError by which a volume says that it is full."""


class RecordingStore(Protocol):
    """The database of one agent's recordings, for two threads. Every method raises UnavailableError when it does not
    answer. Collections are made by the first write to them."""

    def known(self, recording: str) -> Iterable[tuple[str, int, str]]:
        """Topic, stamp and SHA-256 of every message that is stored already."""
        ...

    def documents(self, recording: str) -> Iterable[tuple[str, Mapping[str, Any]]]:
        """Collection and document of everything that the database has of the recording; samples without their data."""
        ...

    def finished(self, volume: str) -> Collection[str]:
        """Paths of the segments of a volume whose end the database knows of."""
        ...

    def write(self, writes: Sequence[Write]) -> None:
        """Do all writes in their order; returns when the database has acknowledged them. DocumentError: it can never
        accept one of them."""
        ...

    def ping(self) -> None:
        """Return when the database answers with this account."""
        ...

    def close(self) -> None:
        """Give the connections back."""
        ...


class RecordingReader(Protocol):
    """Reading access to a database of recordings. Every method raises UnavailableError when it does not answer."""

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        """The documents of `recordings`, oldest first."""
        ...

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The documents of `samples` that belong to the recording."""
        ...

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The documents of `segments_index` that belong to the recording."""
        ...

    def segments(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """The documents of `segments` that belong to the recording."""
        ...

    def audits(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """The documents of `audits` that belong to the recording."""
        ...

    def manifests(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """The documents of `manifests` that belong to the recording: manifests and their parts."""
        ...


class Segments(Protocol):
    """Appends large messages to MCAP files of one recording. Used by one thread."""

    def append(self, messages: Sequence[tuple[Received, str]]) -> Sequence[SegmentPlace]:
        """Write messages with their types and return when they are on the disk.

        The answer has the places of as many as are there, from the first one on.

        OSError when the volume refuses the first: then nothing is kept and all may be appended again. ValueError names
        a message that no segment can hold."""
        ...

    def settle(self, bytes_max: int) -> None:
        """Do some of the work that `close` would have to do: go through at most so many bytes of the file."""
        ...

    def close(self) -> None:
        """Finish the open file (index and footer)."""
        ...

    def closed(self) -> Sequence[ClosedSegment]:
        """The files finished since the last call."""
        ...


class SegmentRepair(Protocol):
    """Finishes the segments below a volume claim whose writers are gone."""

    def unfinished(self, finished: Collection[str]) -> Sequence[str]:
        """Paths below the volume claim of files that nobody writes, without those that are known to be finished."""
        ...

    def messages(self, segment: str) -> Sequence[SegmentMessage]:
        """The whole messages in the file; none when somebody writes it. OSError when the volume refuses."""
        ...

    def finish(self, segment: str) -> ClosedSegment | None:
        """Cut the file behind its last whole record and give it an end, if it has none.

        None: somebody else writes it, or it held no message and is gone. OSError when the volume refuses."""
        ...


class SegmentReader(Protocol):
    """Reads back from the segments of all volumes within reach."""

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        """The message's bytes; UnavailableError when the volume is not within reach or the file has no such message."""
        ...

    def digest(self, volume: str, segment: str) -> tuple[str, int]:
        """SHA-256 and size of the whole file; UnavailableError as `read`."""
        ...

    def notes(self, volume: str, recording: str) -> Mapping[str, Sequence[str]]:
        """The lines that writers of the recording have noted on the volume, by their lives; UnavailableError when the
        volume is not within reach."""
        ...


@dataclass(frozen=True)
class Batch:
    """A part of the spool. `size`: its bytes; `given_up`: its messages are gone, audits in their place say so."""

    name: str
    size: int
    given_up: bool


class Spool(Protocol):
    """Writes that the database has not acknowledged yet, kept on the volume claim. OSError: the volume refuses."""

    def put(self, writes: Sequence[Write]) -> str:
        """Keep them; returns the batch's name when they are on the disk. After an OSError nothing of them is there."""
        ...

    def batches(self) -> Sequence[Batch]:
        """What is kept, oldest first."""
        ...

    def read(self, batch: str) -> Sequence[Write]:
        """The writes of one batch; DocumentError: it is damaged or gone, or cannot be read while the volume works."""
        ...

    def give_up(self, batch: str, writes: Sequence[Write]) -> None:
        """Put these few writes in the place of a batch, in the order too, to free space. On a volume that is full they
        are written over it, and a kill in mid-write damages it; else it has the ones or the others."""
        ...

    def remove(self, batch: str) -> None:
        """Forget a batch."""
        ...


class WritableVolume(Protocol):
    """The volume that a recorder writes to. Every method raises OSError when the volume is not there."""

    def segments(self, recording: str) -> Segments:
        """A new writer for a recording."""
        ...

    def spool(self) -> Spool:
        """The spool on the volume."""
        ...

    def repairs(self) -> SegmentRepair:
        """The repair of files whose writers are gone."""
        ...

    def note(self, recording: str, life: str, lines: Sequence[str]) -> None:
        """Note lines for a writer of the recording, behind those that are there; returns when they are on the disk."""
        ...

    def noted_of(self, recording: str) -> Mapping[str, Sequence[str]]:
        """The lines that writers of the recording have noted, by their lives."""
        ...
