"""Finishes segments whose writers were killed: cut behind the last whole record, summary and footer written."""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from io import BufferedRandom, BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from robotkube.robots.recording.adapters.segments.records import MAGIC, MESSAGE, RECORD, Contents
from robotkube.robots.recording.core.documents import ClosedSegment, SegmentMessage, SegmentPlace

FILES_MAX = 10_000
SMALL_RECORD_BYTES_MAX = 16 * 1024 * 1024
_READ_BYTES = 1024 * 1024
_OURS = re.compile(r"\d+-\d{4,}\.mcap")
"""Names of segments; other MCAP files on the volume, such as exports, are somebody else's."""


class McapRepair:
    """Finishes the segments below `root` whose writers are gone."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def unfinished(self, finished: Collection[str]) -> Sequence[str]:
        """Unfinished files in the order of their names; at most FILES_MAX, the others are for the next start."""
        ours = (path for path in self._root.glob("*/*.mcap") if _OURS.fullmatch(path.name))
        names = sorted({str(path.relative_to(self._root)) for path in ours} - set(finished))
        return [name for name in names[:FILES_MAX] if not _busy(self._root / name)]

    def messages(self, segment: str) -> Sequence[SegmentMessage]:
        """The whole messages in the file."""
        with _locked(self._root / segment) as file:
            return _scan(segment, file).messages if file else ()

    def finish(self, segment: str) -> ClosedSegment | None:
        """Give the file its end, as the port says."""
        path = self._root / segment
        with _locked(path) as file:
            if file is None:
                return None
            scan = _scan(segment, file)
            if not scan.messages:
                if scan.strange:
                    raise OSError("it holds no message that can be read, but something else; look at it, and move it")
                path.unlink()
                return None
            return _finish(segment, file, scan)


def _scan(segment: str, file: BufferedRandom) -> _Scan:
    scan = _Scan(segment, file)
    scan.run()
    return scan


def _finish(segment: str, file: BufferedRandom, scan: _Scan) -> ClosedSegment:
    cut = 0
    if not _ended(file):
        cut = os.fstat(file.fileno()).st_size - scan.end
        os.ftruncate(file.fileno(), scan.end)
        file.seek(scan.end)
        file.write(scan.contents.ending(scan.end))
        file.flush()
        os.fsync(file.fileno())
    file.seek(0)
    digest = hashlib.file_digest(file, "sha256").hexdigest()
    return ClosedSegment(segment, digest, file.tell(), scan.contents.messages, cut)


class _Scan:
    """Goes through the records of one file. `end`: where the last whole record of the data ends; `strange`: there comes
    something that no writer of ours has begun."""

    def __init__(self, segment: str, file: BufferedRandom) -> None:
        self._segment = segment
        self._file = file
        self.contents = Contents()
        self.messages: list[SegmentMessage] = []
        self.end = 0
        self.strange = False

    def run(self) -> None:
        """Scan up to the first record that is not whole, not of a writer of ours, or the end of the data."""
        magic = self._file.read(len(MAGIC))
        if magic != MAGIC:
            self.strange = not MAGIC.startswith(magic)
            return
        self.end = len(MAGIC)
        size = os.fstat(self._file.fileno()).st_size
        while True:
            prefix = self._file.read(RECORD.size)
            if len(prefix) < RECORD.size:
                return
            opcode, length = RECORD.unpack(prefix)
            if opcode == Opcode.DATA_END or self.end + RECORD.size + length > size:
                return
            if not self._scan_record(opcode, length):
                self.strange = True
                return
            self.end += RECORD.size + length

    def _scan_record(self, opcode: int, length: int) -> bool:
        if opcode == Opcode.MESSAGE:
            return length >= MESSAGE.size and self._message(length - MESSAGE.size)
        if opcode not in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL) or length > SMALL_RECORD_BYTES_MAX:
            return False
        stream = ReadDataStream(BytesIO(self._file.read(length)))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.contents.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                self.contents.channels[channel.id] = channel
        except (McapError, ValueError, OSError):
            return False
        return True

    def _message(self, size: int) -> bool:
        number, _, received, stamp = MESSAGE.unpack(self._file.read(MESSAGE.size))
        channel = self.contents.channels.get(number)
        if channel is None:
            return False
        sha256 = self._digest(size)
        place = SegmentPlace(self._segment, self.end)
        self.messages.append(SegmentMessage(channel.topic, stamp, received, sha256, size, place))
        self.contents.count(number, received)
        return True

    def _digest(self, size: int) -> str:
        digest = hashlib.sha256()
        while size:
            data = self._file.read(min(size, _READ_BYTES))
            digest.update(data)
            size -= len(data)
        return digest.hexdigest()


def _ended(file: BufferedRandom) -> bool:
    """Return whether the file has the magic of its end."""
    if os.fstat(file.fileno()).st_size < 2 * len(MAGIC):
        return False
    file.seek(-len(MAGIC), os.SEEK_END)
    return file.read() == MAGIC


def _busy(path: Path) -> bool:
    """Return whether somebody writes it; of a file that cannot be opened the repair itself has to say why."""
    try:
        with _locked(path) as file:
            return file is None
    except OSError:
        return False


@contextmanager
def _locked(path: Path) -> Iterator[BufferedRandom | None]:
    """The file, locked as its writer would; None when somebody has it or it is gone."""
    try:
        file = path.open("r+b")
    except FileNotFoundError:
        yield None
        return
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield None
            return
        yield file
