"""Database and volume claim of recordings in memory, which can be away, full, or the last thing a process ever called.

Both outlive the processes that use them: `killer` is called before each step that leaves something behind, and may
raise Killed there, as kill -9 does.
"""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.errors import DocumentError, UnavailableError
from robotkube.robots.recording.core.documents import (
    AUDITS,
    INDEX,
    MANIFESTS,
    RECORDINGS,
    SAMPLES,
    SEGMENTS,
    ClosedSegment,
    Received,
    SegmentMessage,
    SegmentPlace,
    Write,
)
from robotkube.robots.recording.ports import Batch

DOCUMENT_BYTES = 100


class Killed(BaseException):
    """The end of the process, here and now."""


def nobody() -> None:
    """A killer that kills nobody."""


@dataclass
class RecordingDatabase:
    """Collections by name, documents by `_id`; store and reader at once. `away`: it does not answer. `manifest_killer`:
    called instead of `killer` before what is of manifests."""

    killer: Callable[[], None] = nobody
    manifest_killer: Callable[[], None] = nobody
    away: bool = False
    collections: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)

    def known(self, recording: str) -> Iterator[tuple[str, int, str]]:
        """Topic, stamp and SHA-256 of every stored message."""
        for bucket in self.buckets(recording):
            for sample in bucket["samples"]:
                yield bucket["topic"], sample["stamp"], sample["sha256"]
        for entry in self.index(recording):
            yield entry["topic"], entry["stamp"], entry["sha256"]

    def documents(self, recording: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """See the port."""
        self.ping()
        own = self.collections.get(RECORDINGS, {}).get(recording)
        if own is not None:
            yield RECORDINGS, dict(own)
        for collection in (SAMPLES, INDEX, SEGMENTS, AUDITS, MANIFESTS):
            for document in self._of(collection, recording):
                yield collection, dict(document)

    def finished(self, volume: str) -> Collection[str]:
        """See the port."""
        self.ping()
        known = self.collections.get(SEGMENTS, {}).values()
        return {segment["segment"] for segment in known if segment["volume"] == volume and segment["sha256"]}

    def write(self, writes: Sequence[Write]) -> None:
        """Do all writes; the process may be killed between any two."""
        for write in writes:
            self.ping()
            self.manifest_killer() if write.collection == MANIFESTS else self.killer()
            documents = self.collections.setdefault(write.collection, {})
            if not write.update:
                documents.setdefault(write.id, {**write.document, "_id": write.id})
            elif write.id in documents:
                document = documents[write.id]
                for path, value in write.document.items():
                    outer, _, inner = path.rpartition(".")
                    (document.setdefault(outer, {}) if outer else document)[inner] = value
                for name, value in write.add.items():
                    document[name] = [*document[name], *([] if value in document[name] else [value])]

    def ping(self) -> None:
        """See the port."""
        if self.away:
            raise UnavailableError("database: is away")

    def close(self) -> None:
        """See the port."""

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        """See the port."""
        self.ping()
        return list(self.collections.get(RECORDINGS, {}).values())

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """See the port."""
        return self._of(SAMPLES, recording)

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """See the port."""
        return self._of(INDEX, recording)

    def segments(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """See the port."""
        return self._of(SEGMENTS, recording)

    def audits(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """See the port."""
        return self._of(AUDITS, recording)

    def manifests(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """See the port."""
        return self._of(MANIFESTS, recording)

    def _of(self, collection: str, recording: str) -> list[Mapping[str, Any]]:
        self.ping()
        documents = self.collections.get(collection, {}).values()
        return [document for document in documents if document["recording"] == recording]


@dataclass
class _File:
    messages: list[Received] = field(default_factory=list)
    ended: bool = False
    writer: object = None


@dataclass
class RecordingVolume:
    """A volume claim: segments, spool, repairs. `away`: every access fails; `bytes_max`: beyond it the disk is full.

    `forget_writers` does what the end of a process does to its locks."""

    killer: Callable[[], None] = nobody
    manifest_killer: Callable[[], None] = nobody
    away: bool = False
    bytes_max: int = 1 << 60
    files: dict[str, _File] = field(default_factory=dict)
    batches: dict[str, tuple[list[Write], bool]] = field(default_factory=dict)
    noted: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    number: int = 0

    def forget_writers(self) -> None:
        """End all writers: nobody writes any file any more."""
        for file in self.files.values():
            file.writer = None

    def require(self, size: int = 0) -> None:
        """Check that the volume is there and so many bytes more fit; else OSError."""
        if self.away:
            raise OSError(errno.EIO, "the volume is away")
        if self._used() + size > self.bytes_max:
            raise OSError(errno.ENOSPC, "No space left on device")

    def segments(self, recording: str) -> MemorySegments:
        """See the port."""
        self.require()
        return MemorySegments(self, recording)

    def spool(self) -> MemorySpool:
        """See the port."""
        self.require()
        return MemorySpool(self)

    def repairs(self) -> MemoryRepair:
        """See the port."""
        self.require()
        return MemoryRepair(self)

    def note(self, recording: str, life: str, lines: Sequence[str]) -> None:
        """See the port."""
        self.require(sum(map(len, lines)))
        self.manifest_killer()
        self.noted.setdefault((recording, life), []).extend(lines)

    def noted_of(self, recording: str) -> Mapping[str, Sequence[str]]:
        """See the port."""
        self.require(-(1 << 60))
        return {life: lines for (name, life), lines in self.noted.items() if name == recording}

    def notes(self, volume: str, recording: str) -> Mapping[str, Sequence[str]]:
        """See the port of reading."""
        return self.noted_of(recording)

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        """See the port of reading."""
        try:
            data = self.files[place.segment].messages[place.offset].data
        except (KeyError, IndexError) as error:
            raise UnavailableError(f"{volume}: {place.segment} at {place.offset}: there is no message") from error
        return data[:size]

    def digest(self, volume: str, segment: str) -> tuple[str, int]:
        """See the port of reading."""
        if segment not in self.files:
            raise UnavailableError(f"{volume}: {segment}: No such file")
        return whole(self.files[segment].messages)

    def name(self) -> str:
        """A new name, later than all others."""
        self.number += 1
        return f"{self.number:06d}"

    def _used(self) -> int:
        spooled = sum(_size(writes) for writes, _ in self.batches.values())
        return spooled + sum(len(message.data) for file in self.files.values() for message in file.messages)


def _size(writes: Sequence[Write]) -> int:
    return sum(max(write.size, DOCUMENT_BYTES) for write in writes)


def whole(messages: Sequence[Received]) -> tuple[str, int]:
    """Digest and size of a file with these messages."""
    data = b"".join(message.data for message in messages)
    return hashlib.sha256(data).hexdigest(), len(data)


class MemorySegments:
    """One file for all messages of a writer."""

    def __init__(self, volume: RecordingVolume, recording: str) -> None:
        self._volume = volume
        self._name = f"{recording}/{volume.name()}.mcap"
        self._closed: list[ClosedSegment] = []

    def append(self, messages: Sequence[tuple[Received, str]]) -> Sequence[SegmentPlace]:
        """Append messages; the process may be killed between any two."""
        places: list[SegmentPlace] = []
        for message, _ in messages:
            try:
                self._volume.require(len(message.data))
            except OSError:
                if places:
                    return places
                raise
            self._volume.killer()
            file = self._volume.files.setdefault(self._name, _File(writer=self))
            places.append(SegmentPlace(self._name, len(file.messages)))
            file.messages.append(message)
        self._volume.killer()
        return places

    def settle(self, bytes_max: int) -> None:
        """Do nothing: nothing is to be done before the end."""

    def close(self) -> None:
        """See the port."""
        file = self._volume.files.get(self._name)
        if file is not None and not file.ended:
            self._volume.require()
            self._volume.killer()
            file.ended = True
            self._closed.append(ClosedSegment(self._name, *whole(file.messages), messages=len(file.messages)))

    def closed(self) -> Sequence[ClosedSegment]:
        """See the port."""
        closed = self._closed
        self._closed = []
        return closed


@dataclass
class MemoryRepair:
    """Ends files whose writers are gone."""

    volume: RecordingVolume

    def unfinished(self, finished: Collection[str]) -> Sequence[str]:
        """See the port."""
        return [name for name, file in self.volume.files.items() if file.writer is None and name not in finished]

    def messages(self, segment: str) -> Sequence[SegmentMessage]:
        """See the port."""
        self.volume.require(-(1 << 60))
        return [
            SegmentMessage(
                message.topic,
                message.stamp,
                message.received,
                hashlib.sha256(message.data).hexdigest(),
                len(message.data),
                SegmentPlace(segment, offset),
            )
            for offset, message in enumerate(self.volume.files[segment].messages)
        ]

    def finish(self, segment: str) -> ClosedSegment | None:
        """See the port."""
        self.volume.require()
        self.volume.killer()
        file = self.volume.files[segment]
        file.ended = True
        return ClosedSegment(segment, *whole(file.messages), messages=len(file.messages))


@dataclass
class MemorySpool:
    """Batches by name."""

    volume: RecordingVolume

    def put(self, writes: Sequence[Write]) -> str:
        """See the port."""
        self.volume.require(_size(writes))
        self.volume.killer()
        name = f"{self.volume.name()}.bson"
        self.volume.batches[name] = (list(writes), False)
        return name

    def batches(self) -> Sequence[Batch]:
        """See the port."""
        return [
            Batch(name, _size(writes), given_up) for name, (writes, given_up) in sorted(self.volume.batches.items())
        ]

    def read(self, batch: str) -> Sequence[Write]:
        """See the port."""
        self.volume.require(-(1 << 60))
        if batch not in self.volume.batches:
            raise DocumentError(batch, ["is gone"])
        return self.volume.batches[batch][0]

    def give_up(self, batch: str, writes: Sequence[Write]) -> None:
        """See the port."""
        self.volume.require(-(1 << 60))
        self.volume.killer()
        self.volume.batches[batch] = (list(writes), True)

    def remove(self, batch: str) -> None:
        """See the port."""
        self.volume.require(-(1 << 60))
        self.volume.killer()
        self.volume.batches.pop(batch, None)
