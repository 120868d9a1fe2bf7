"""Large messages in MCAP files below a claim, readable at any moment and after a crash.

Written without chunks: every message is a record of its own in the file, so an index entry (file, offset) finds it
without the file's own index, and a file whose writer was killed lacks only its footer (MCAP specification, "Message
record"). Layout below the claim: `<recording>/<ns>-<number>.mcap`; ns is when the writer started, so a second writer
of the same recording never touches the first one's files.
"""

from __future__ import annotations

import os
import re
import struct
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, IndexType, Writer

from robotkube.domain.errors import UnavailableError
from robotkube.domain.recordings import Received, SegmentPlace

SEGMENT_BYTES_MAX = 256 * 1024 * 1024
SCHEMA_FIELDS_DEPTH_MAX = 16

_MESSAGE_OPCODE = 0x05
_RECORD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; the data follow
_BUILT_IN = re.compile(r"(u?int(8|16|32|64)|float(32|64)|bool|byte|char|w?string)$")


def definition(type_name: str, share: Path) -> str:
    """The type's definition with all types it uses, in MCAP's `ros2msg` form; `""` when `share` does not have it."""
    parts: dict[str, str] = {}
    try:
        _collect(type_name, share, parts, 0)
    except OSError:
        return ""
    first, *others = parts.items()
    return "\n".join([first[1], *(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)])


def _collect(type_name: str, share: Path, parts: dict[str, str], depth: int) -> None:
    package, name = type_name.split("/")[0], type_name.split("/")[-1]
    key = f"{package}/{name}"
    if key in parts or depth > SCHEMA_FIELDS_DEPTH_MAX:
        return
    text = parts[key] = (share / package / "msg" / f"{name}.msg").read_text()
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2:
            continue
        field = re.sub(r"(<=\d+)?(\[.*\])?$", "", words[0])
        if not _BUILT_IN.match(field):
            used = field if "/" in field else f"{'std_msgs' if field == 'Header' else package}/{field}"
            _collect(used, share, parts, depth + 1)


class McapSegments:
    """Appends to the current segment of one recording; begins a new one when it is full (`bytes_max`).

    Used by one thread. Every method raises OSError when the volume refuses.
    """

    def __init__(
        self,
        root: Path,
        recording: str,
        clock_ns: Callable[[], int],
        bytes_max: int = SEGMENT_BYTES_MAX,
        share: Path | None = None,
    ) -> None:
        self._root, self._recording = root, recording
        self._started, self._number, self._bytes_max = clock_ns(), 0, bytes_max
        self._share = share or Path(sys.prefix) / "share"
        self._file: BinaryIO | None = None
        self._writer: Writer | None = None
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._dirty = False

    def append(self, message: Received, type_name: str) -> SegmentPlace:
        """Write the message's record behind the others; safe only after the next `synchronise`.

        After an OSError the segment is given up as it is: what was not synchronised must be appended again."""
        try:
            return self._append(message, type_name)
        except OSError:
            self._give_up()
            raise

    def _append(self, message: Received, type_name: str) -> SegmentPlace:
        if self._file is None or self._writer is None or self._file.tell() >= self._bytes_max:
            self.close()
            self._open()
        assert self._file is not None
        assert self._writer is not None
        channel = self._channel(message.topic, type_name)
        sequence = self._sequences[message.topic] = self._sequences.get(message.topic, -1) + 1
        self._writer.add_message(channel, message.received, message.data, message.stamp, sequence % 2**32)
        self._dirty = True
        # the writer puts pending channel records before the message: count back from the end
        offset = self._file.tell() - len(message.data) - _MESSAGE.size - _RECORD.size
        return SegmentPlace(self._name(), offset)

    def synchronise(self) -> None:
        """Returns when everything appended so far is on the disk; gives the segment up as `append` does."""
        if self._file is None or not self._dirty:
            return
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError:
            self._give_up()
            raise
        self._dirty = False

    def close(self) -> None:
        """Finish the current segment: index, footer, on the disk. Without a segment nothing happens."""
        if self._file is None or self._writer is None:
            return
        file, writer = self._file, self._writer
        self._file = self._writer = None
        try:
            writer.finish()  # type: ignore[no-untyped-call]
            file.flush()
            os.fsync(file.fileno())
        finally:
            file.close()

    def _give_up(self) -> None:
        file, self._file, self._writer = self._file, None, None
        if file is not None:
            with suppress(OSError):
                file.close()

    def _name(self) -> str:
        return f"{self._recording}/{self._started}-{self._number:04d}.mcap"

    def _open(self) -> None:
        self._number += 1
        path = self._root / self._name()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("xb", buffering=1 << 20)
        self._writer = Writer(
            self._file, use_chunking=False, compression=CompressionType.NONE, index_types=IndexType.NONE
        )
        self._writer.start(profile="ros2")
        self._channels = {}
        folder = os.open(path.parent, os.O_RDONLY)  # the file's name has to survive, too
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _channel(self, topic: str, type_name: str) -> int:
        if topic not in self._channels:
            assert self._writer is not None
            text = definition(type_name, self._share)
            encoding = "ros2msg" if text else ""
            schema = self._writer.register_schema(type_name, encoding, text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        return self._channels[topic]


class McapSegmentReader:
    """Reads single messages from the claims of several volumes. `roots`: volume `<node>/<claim>` -> folder."""

    def __init__(self, roots: Mapping[str, Path]) -> None:
        self._roots = dict(roots)

    def read(self, volume: str, place: SegmentPlace, size: int) -> bytes:
        """The message's bytes, straight from its record; UnavailableError says which volume, file or record fails."""
        where = f"{volume}: {place.segment} at {place.offset}"
        root = self._roots.get(volume)
        if root is None:
            node, _, claim = volume.partition("/")
            raise UnavailableError(f"{where}: claim {claim} of node {node} is not within reach")
        path = (root / place.segment).resolve()
        if not path.is_relative_to(root.resolve()):
            raise UnavailableError(f"{where}: leads out of the volume")
        try:
            with path.open("rb") as file:
                file.seek(place.offset)
                record = file.read(_RECORD.size + _MESSAGE.size + size)
        except OSError as error:
            raise UnavailableError(f"{where}: {error.strerror}") from error
        if len(record) < _RECORD.size + _MESSAGE.size + size:
            raise UnavailableError(f"{where}: the file ends within the message")
        opcode, length = _RECORD.unpack_from(record)
        if opcode != _MESSAGE_OPCODE or length != _MESSAGE.size + size:
            raise UnavailableError(f"{where}: there is no message of {size} bytes")
        return record[_RECORD.size + _MESSAGE.size :]
