"""The records of MCAP files (MCAP specification, "Records"), as far as reading messages needs them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, ChunkIndex, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
FOOTER = 0x02
SCHEMA = 0x03
CHANNEL = 0x04
MESSAGE = 0x05
CHUNK = 0x06
MESSAGE_INDEX = 0x07
CHUNK_INDEX = 0x08
STATISTICS = 0x0B
DATA_END = 0x0F

RECORD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK_HEAD = struct.Struct("<QQQI")  # first and last log time, size unpacked, checksum
FOOTER_BODY = struct.Struct("<QQI")  # summary, summary offsets, checksum
INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of entries
INDEX_ENTRY = struct.Struct("<QQ")  # log time, place in the unpacked chunk
LENGTH = struct.Struct("<I")
SIZE = struct.Struct("<Q")
COMPRESSION_LETTERS_MAX = 64

_BAD = (McapError, struct.error, ValueError, KeyError, OverflowError, MemoryError)


@dataclass(slots=True)
class ChunkPlace:
    """The place of a chunk's record; `indexes`: channel -> place of its message index, empty when they are unknown."""

    first: int
    last: int
    start: int
    length: int
    indexes: Mapping[int, int] = field(default_factory=dict)


@dataclass
class FileContents:
    """The channels, schemas and chunks of a file, as far as they are known."""

    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    statistics: Any = None

    def add(self, opcode: int, body: bytes) -> None:
        """Add a schema, channel, chunk index or statistics record; ValueError when it is none."""
        reader: Any = {SCHEMA: Schema, CHANNEL: Channel, CHUNK_INDEX: ChunkIndex, STATISTICS: Statistics}.get(opcode)
        if reader is None:
            return
        try:
            record = reader.read(ReadDataStream(BytesIO(body)))
        except _BAD as error:
            raise ValueError(f"record of kind {opcode} is damaged ({error or type(error).__name__})") from error
        if opcode == SCHEMA:
            self.schemas[record.id] = record
        elif opcode == CHANNEL:
            self.channels[record.id] = record
        elif opcode == STATISTICS:
            self.statistics = record
        else:
            self.chunks.append(
                ChunkPlace(
                    record.message_start_time, record.message_end_time, record.chunk_start_offset,
                    record.chunk_length, dict(record.message_index_offsets),
                )
            )  # fmt: skip

    @property
    def whole(self) -> bool:
        """Return whether every message lies in a chunk that is listed, and every channel is known."""
        expected = self.statistics
        if expected is None or len(self.channels) != expected.channel_count or len(self.chunks) != expected.chunk_count:
            return False
        named = {number for chunk in self.chunks for number in chunk.indexes}
        known = named <= set(self.channels) and all(c.schema_id in self.schemas for c in self.channels.values())
        return known and bool(self.chunks or not expected.message_count)


def body_records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, place and length of the body of each record that is whole."""
    place = 0
    end = len(data)
    while place + RECORD.size <= end:
        opcode, length = RECORD.unpack_from(data, place)
        place += RECORD.size
        if place + length > end:
            return
        yield opcode, place, length
        place += length


def read_summary(section: bytes, footer: bytes) -> FileContents:
    """The summary of a file; `footer`: the whole record. ValueError when it is damaged."""
    _, start, checksum = FOOTER_BODY.unpack_from(footer, RECORD.size)
    if checksum and zlib.crc32(footer[: -LENGTH.size], zlib.crc32(section)) != checksum:
        raise ValueError("its summary does not fit its checksum")
    contents = FileContents()
    covered = 0
    for opcode, place, length in body_records(section):
        contents.add(opcode, section[place : place + length])
        covered = place + length
    if covered != len(section) or (start and not contents.channels and contents.chunks):
        raise ValueError("its summary is damaged")
    return contents


def chunk_head(data: bytes) -> tuple[int, int, str, int, int]:
    """Size unpacked, checksum, compression, place of the records from the begin of the body, and their stored size.

    ValueError when it is damaged."""
    try:
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        place = CHUNK_HEAD.size
        (letters,) = LENGTH.unpack_from(data, place)
        if letters > COMPRESSION_LETTERS_MAX:
            raise ValueError("a chunk's compression has no name")
        place += LENGTH.size
        kind = bytes(data[place : place + letters]).decode("ascii")
        place += letters
        (stored,) = SIZE.unpack_from(data, place)
    except struct.error as error:
        raise ValueError("a chunk is cut off") from error
    return size, checksum, kind, place + SIZE.size, stored
