"""Where recordings are kept: database, segments on the claim, spool."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from robotkube.domain.recordings import Received, SegmentPlace, Write


class RecordingStore(Protocol):
    """The database of one agent's recordings. Every method raises UnavailableError when it does not answer."""

    def begin(self, recording: str, document: Mapping[str, Any], volume: str) -> None:
        """Make the recording's document, or take up an existing one: `ended` becomes null, `volume` is added."""
        ...

    def known(self, recording: str) -> Iterable[tuple[str, int, str]]:
        """Topic, stamp and SHA-256 of every message that is stored already."""
        ...

    def write(self, writes: Sequence[Write]) -> None:
        """Do all writes; returns when the database has acknowledged them."""
        ...

    def ping(self) -> None:
        """Returns when the database answers with this account."""
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


class Segments(Protocol):
    """Appends large messages to MCAP files of one recording."""

    def append(self, message: Received, type_name: str) -> SegmentPlace:
        """Write one message; it is safe only after the next `synchronise`. OSError when the volume refuses."""
        ...

    def synchronise(self) -> None:
        """Returns when everything appended is on the disk."""
        ...

    def close(self) -> None:
        """Finish the open file (index and footer)."""
        ...


class SegmentReader(Protocol):
    """Reads messages back from the segments of all volumes within reach."""

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        """The message's bytes; UnavailableError when the volume is not within reach or the file has no such message."""
        ...


class Spool(Protocol):
    """Writes that the database has not taken yet, kept on the claim."""

    def put(self, recording: str, writes: Sequence[Write]) -> str:
        """Keep them; returns the batch's name when they are on the disk. OSError when the volume refuses."""
        ...

    def batches(self) -> Sequence[str]:
        """Names of what is kept, oldest first."""
        ...

    def read(self, batch: str) -> Sequence[Write]:
        """The writes of one batch."""
        ...

    def remove(self, batch: str) -> None:
        """Forget a batch that was written."""
        ...
