"""The bytes of an MCAP file without chunks: header, schemas, channels, messages, and an end that readers find.

Small records are made by the mcap library; a message's record is put before its payload without copying it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, McapRecord, Schema, Statistics, SummaryOffset

MAGIC = b"\x89MCAP0\r\n"
MESSAGE_OPCODE = 0x05
RECORD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; the data follow
STAMP_MAX = 2**63 - 1
MESSAGE_BYTES_MAX = 2**32 - 1
CHANNELS_MAX = 2**16 - 1
LIBRARY = "robotkube"
NOTES = ".manifest"
"""The end of the name of a file beside the segments that has what a writer noted."""

_PREFIX = struct.Struct("<BQHIQQ")


def beginning() -> bytes:
    """Magic and header."""
    return MAGIC + _bytes(Header(profile="ros2", library=LIBRARY))


def message_prefix(channel: int, sequence: int, received: int, stamp: int, size: int) -> bytes:
    """Everything of a message's record before its payload of `size` bytes."""
    return _PREFIX.pack(MESSAGE_OPCODE, MESSAGE.size + size, channel, sequence, received, stamp)


@dataclass
class Contents:
    """What a file holds so far: as much as its summary says."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0

    @property
    def messages(self) -> int:
        """How many messages."""
        return sum(self.counts.values())

    def channel(self, topic: str, type_name: str, definition: str) -> tuple[Channel, bytes]:
        """A new channel with a schema of its own, and both as records."""
        number = len(self.channels) + 1
        encoding = "ros2msg" if definition else ""
        schema = Schema(id=number, name=type_name, encoding=encoding, data=definition.encode())
        channel = Channel(id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=number)
        self.schemas[number] = schema
        self.channels[number] = channel
        return channel, _bytes(schema, channel)

    def count(self, channel: int, received: int) -> None:
        """Count a message that was received at this time (the log time of its record)."""
        self.first = min(self.first, received) if self.messages else received
        self.last = max(self.last, received)
        self.counts[channel] = self.counts.get(channel, 0) + 1

    def copy(self) -> Contents:
        """A copy that may change without this one."""
        return Contents(dict(self.schemas), dict(self.channels), dict(self.counts), self.first, self.last)

    def ending(self, position: int) -> bytes:
        """The bytes that complete a file of `position` bytes: end of data, summary, footer, magic."""
        ended = _bytes(DataEnd(data_section_crc=0))
        start = position + len(ended)
        groups = {
            Opcode.SCHEMA: _bytes(*self.schemas.values()),
            Opcode.CHANNEL: _bytes(*self.channels.values()),
            Opcode.STATISTICS: _bytes(self._statistics()),
        }
        summary = b"".join(groups.values())
        footer = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        return ended + summary + _offsets(groups, start) + _bytes(footer) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=0,
            message_count=self.messages,
            message_end_time=self.last,
            message_start_time=self.first,
            metadata_count=0,
            schema_count=len(self.schemas),
        )


def _offsets(groups: Mapping[Opcode, bytes], start: int) -> bytes:
    offsets = []
    for opcode, group in groups.items():
        offsets.append(SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(group)))
        start += len(group)
    return _bytes(*(offset for offset in offsets if offset.group_length))


def _bytes(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
