"""Appends messages to the current segment of one recording."""

from __future__ import annotations

import fcntl
import hashlib
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotkube.robots.recording.adapters.segments.records import (
    CHANNELS_MAX,
    MESSAGE_BYTES_MAX,
    STAMP_MAX,
    Contents,
    beginning,
    message_prefix,
)
from robotkube.robots.recording.core.documents import ClosedSegment, Received, SegmentPlace
from robotkube.robots.ros.adapters.installed_definitions import definition

SEGMENT_BYTES_MAX = 256 * 1024 * 1024
PARTS_AT_ONCE_MAX = 1000  # of the 1024 that the kernel takes (IOV_MAX)
HASH_BYTES = 1024 * 1024


@dataclass
class _File:
    """The open segment. `size`: bytes that are safe on the disk; `hashed`: how many of them are in `digest`."""

    name: str
    descriptor: int
    size: int = 0
    hashed: int = 0
    contents: Contents = field(default_factory=Contents)
    digest: Any = field(default_factory=hashlib.sha256)


class McapSegments:
    """Appends messages to the current segment; begins a new one when it is full (`bytes_max`)."""

    def __init__(
        self,
        root: Path,
        recording: str,
        clock_ns: Callable[[], int],
        bytes_max: int = SEGMENT_BYTES_MAX,
        share: Path | None = None,
    ) -> None:
        self._root = root
        self._recording = recording
        self._started = clock_ns()
        self._number = 0
        self._bytes_max = bytes_max
        self._share = share or Path(sys.prefix) / "share"
        self._file: _File | None = None
        self._closed: list[ClosedSegment] = []
        self._definitions: dict[str, str] = {}

    def append(self, messages: Sequence[tuple[Received, str]]) -> Sequence[SegmentPlace]:
        """Write the messages behind the others and return when they are on the disk, as the port says."""
        for message, type_name in messages:
            check(message, type_name)
        places: list[SegmentPlace] = []
        rest = list(messages)
        while rest:
            try:
                file = self._present()
                part = _fitting(rest, self._bytes_max - file.size)
                places += self._append(file, part)
            except OSError:
                if places:
                    break
                raise
            rest = rest[len(part) :]
        return places

    def settle(self, bytes_max: int) -> None:
        """Add so many bytes of the file to its digest, as they are on the disk; nobody here reads them again."""
        file = self._file
        if file is None:
            return
        begin = file.hashed
        end = min(file.size, file.hashed + bytes_max)
        while file.hashed < end:
            data = os.pread(file.descriptor, min(HASH_BYTES, end - file.hashed), file.hashed)
            if not data:
                raise OSError(5, f"{file.name} is shorter than what was written to it")
            file.digest.update(data)
            file.hashed += len(data)
        os.posix_fadvise(file.descriptor, begin, end - begin, os.POSIX_FADV_DONTNEED)

    def close(self) -> None:
        """Finish the current segment: summary, footer, on the disk. Without a segment nothing happens.

        After an OSError the file stays without end, for the next writer's repair."""
        file = self._file
        if file is None:
            return
        try:
            ending = file.contents.ending(file.size)
            _write(file, [ending], file.contents)
            self.settle(file.size)
            closed = ClosedSegment(file.name, file.digest.hexdigest(), file.size, file.contents.messages)
            self._closed.append(closed)
        finally:
            self._file = None
            os.close(file.descriptor)

    def closed(self) -> Sequence[ClosedSegment]:
        """The files finished since the last call."""
        closed = self._closed
        self._closed = []
        return closed

    def _present(self) -> _File:
        if self._file is not None and self._file.size >= self._bytes_max:
            self.close()
        if self._file is None:
            self._file = self._open()
        return self._file

    def _open(self) -> _File:
        self._number += 1
        name = f"{self._recording}/{self._started}-{self._number:04d}.mcap"
        path = self._root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _File(name, os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644))
        try:
            fcntl.flock(file.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _write(file, [beginning()], file.contents)
            synchronise_folder(path.parent)
        except OSError:
            os.close(file.descriptor)
            path.unlink(missing_ok=True)
            raise
        return file

    def _append(self, file: _File, messages: Sequence[tuple[Received, str]]) -> list[SegmentPlace]:
        contents = file.contents.copy()
        position = file.size
        known = {channel.topic: channel.id for channel in contents.channels.values()}
        parts: list[bytes] = []
        places = []
        for message, type_name in messages:
            channel = known.get(message.topic)
            if channel is None:
                opened, records = contents.channel(message.topic, type_name, self._definition(type_name))
                channel = known[message.topic] = opened.id
                parts.append(records)
                position += len(records)
            sequence = contents.counts.get(channel, 0) % 2**32
            prefix = message_prefix(channel, sequence, message.received, message.stamp, len(message.data))
            places.append(SegmentPlace(file.name, position))
            parts += (prefix, message.data)
            position += len(prefix) + len(message.data)
            contents.count(channel, message.received)
        self._keep(file, parts, contents)
        return places

    def _keep(self, file: _File, parts: list[bytes], contents: Contents) -> None:
        try:
            _write(file, parts, contents)
        except OSError:
            if not _shortened(file):
                self._file = None
                os.close(file.descriptor)
            raise

    def _definition(self, type_name: str) -> str:
        if type_name not in self._definitions:
            self._definitions[type_name] = definition(type_name, self._share)
        return self._definitions[type_name]


def check(message: Received, type_name: str) -> None:
    """Check that a segment can hold the message; ValueError when none can."""
    for what, number in (("stamp", message.stamp), ("time of reception", message.received)):
        if not 0 <= number <= STAMP_MAX:
            raise ValueError(f"{message.topic}: its {what} {number} is none of a segment's")
    if len(message.data) > MESSAGE_BYTES_MAX:
        raise ValueError(f"{message.topic}: {len(message.data)} bytes of {type_name} are more than a segment holds")


def _fitting(messages: Sequence[tuple[Received, str]], bytes_left: int) -> Sequence[tuple[Received, str]]:
    """The first messages that fit into the bytes left, at least one."""
    size = 0
    for number, (message, _) in enumerate(messages):
        size += len(message.data)
        if size > bytes_left or number >= CHANNELS_MAX:
            return messages[: max(1, number)]
    return messages


def _write(file: _File, parts: list[bytes], contents: Contents) -> None:
    """Append parts, synchronise, and only then count them."""
    size = file.size
    for start in range(0, len(parts), PARTS_AT_ONCE_MAX):
        size += _write_parts(file.descriptor, parts[start : start + PARTS_AT_ONCE_MAX])
    os.fdatasync(file.descriptor)
    file.size = size
    file.contents = contents


def _write_parts(descriptor: int, parts: list[bytes]) -> int:
    """Write all parts, although the system may write less at once; the number of bytes."""
    views = [memoryview(part) for part in parts if part]
    total = sum(len(view) for view in views)
    written = 0
    while views:
        count = os.writev(descriptor, views)
        written += count
        while views and count >= len(views[0]):
            count -= len(views.pop(0))
        if views and count:
            views[0] = views[0][count:]
    assert written == total
    return written


def _shortened(file: _File) -> bool:
    """Cut the file back to what was safe before; True when that succeeded, and it may be gone on with.

    After a failed synchronisation nobody knows what the disk has: the file is left."""
    with suppress(OSError):
        os.ftruncate(file.descriptor, file.size)
        os.fsync(file.descriptor)
        return True
    return False


def synchronise_folder(path: Path) -> None:
    """Synchronise a folder: the name of a new file has to survive, too."""
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
