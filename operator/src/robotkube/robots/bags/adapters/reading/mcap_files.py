"""One MCAP file: by its index, else by going through its records up to where it ends or is damaged."""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from collections.abc import Callable, Collection, Iterator
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.robots.bags.adapters.reading import mcap_records
from robotkube.robots.bags.adapters.reading.compression import unpack
from robotkube.robots.bags.adapters.reading.mcap_records import ChunkPlace, FileContents
from robotkube.robots.bags.adapters.reading.metadata import topic
from robotkube.robots.bags.core.playback import BagTopic

CHUNK_BYTES_MAX = 256 * 1024 * 1024
SUMMARY_BYTES_MAX = 256 * 1024 * 1024
SMALL_BYTES_MAX = 16 * 1024 * 1024
MESSAGE_BYTES_MAX = 1024 * 1024 * 1024
OPEN_BYTES_MAX = 512 * 1024 * 1024
SERIALISATION = "cdr"
DEFINITION = "ros2msg"
_AHEAD = 4096
_HEAD = mcap_records.RECORD.size + mcap_records.MESSAGE_HEAD.size

StoredMessage = tuple[int, int, bytes]
"""Log time in ns, channel and serialised message."""


class McapFile:
    """One open MCAP file. InputError at construction: not a file of this kind. `complain` hears of damage, of the file
    as `named`."""

    def __init__(self, path: Path, complain: Callable[[str], None], named: Path | None = None) -> None:
        self._path = named or path
        self._complain = complain
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror})") from error
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._times = array("Q")
            self._channels = array("H")
            self._places = array("Q")
            self._known = self._describe()
            self.topics, self.definitions, self._names = self._read_topics()
        except Exception:
            self._file.close()
            raise

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, log time and message in the order of the times; of the topics `wanted`, all when None."""
        numbers = {n for n, name in self._names.items() if wanted is None or name in wanted}
        everything = len(numbers) == len(self._names)
        sources: list[tuple[int, int, Iterator[StoredMessage], StoredMessage]] = []
        self._enter(sources, -1, self._loose(numbers))
        chunks = sorted(
            (c for c in self._known.chunks if not c.indexes or not numbers.isdisjoint(c.indexes)),
            key=lambda chunk: (chunk.first, chunk.start),
        )
        position = 0
        held: dict[int, int] = {}
        while sources or position < len(chunks):
            while position < len(chunks) and (not sources or chunks[position].first <= sources[0][0]):
                messages = self._chunk(chunks[position], numbers, everything)
                held[position] = sum(len(data) for _, _, data in messages)
                if sum(held.values()) > OPEN_BYTES_MAX:
                    raise InputError(f"{self._path}: its messages are in no order at all; sort it: `ros2 bag convert`")
                self._enter(sources, position, iter(messages))
                position += 1
            if not sources:
                continue
            _, order, source, (moment, number, data) = heappop(sources)
            yield self._names[number], moment, data
            if not self._enter(sources, order, source):
                held.pop(order, None)

    @staticmethod
    def _enter(sources: list[Any], order: int, source: Iterator[StoredMessage]) -> bool:
        following = next(source, None)
        if following is None:
            return False
        heappush(sources, (following[0], order, source, following))
        return True

    # what is in the file ---------------------------------------------------------------------------------------------

    def _describe(self) -> FileContents:
        if self._read(0, len(mcap_records.MAGIC)) != mcap_records.MAGIC:
            raise InputError(f"{self._path}: is no MCAP file")
        try:
            summary = self._summary()
        except (ValueError, struct.error) as error:
            self._complain(f"{self._path}: {error}; read without it, as far as it goes")
            return self._scan()
        return summary if summary is not None and summary.whole else self._scan()

    def _summary(self) -> FileContents | None:
        """The file's summary, None when it has none; ValueError when it is cut off or damaged."""
        footer_length = mcap_records.RECORD.size + mcap_records.FOOTER_BODY.size
        footer_at = self._size - len(mcap_records.MAGIC) - footer_length
        if (
            footer_at < len(mcap_records.MAGIC)
            or self._read(self._size - len(mcap_records.MAGIC), 8) != mcap_records.MAGIC
        ):
            raise ValueError("its end is missing, so it was not finished or is cut off")
        footer = self._read(footer_at, footer_length)
        if mcap_records.RECORD.unpack_from(footer) != (mcap_records.FOOTER, mcap_records.FOOTER_BODY.size):
            raise ValueError("its footer is damaged")
        start, _, _ = mcap_records.FOOTER_BODY.unpack_from(footer, mcap_records.RECORD.size)
        if start == 0:
            return None
        if not len(mcap_records.MAGIC) <= start <= footer_at or footer_at - start > SUMMARY_BYTES_MAX:
            raise ValueError("its footer is damaged")
        return mcap_records.read_summary(self._read(start, footer_at - start), footer)

    def _scan(self) -> FileContents:
        """Go through all records, up to the first that is not whole."""
        contents = FileContents()
        place = len(mcap_records.MAGIC)
        while place + mcap_records.RECORD.size <= self._size:
            opcode, length = mcap_records.RECORD.unpack(self._read(place, mcap_records.RECORD.size))
            if opcode == mcap_records.DATA_END:
                return contents
            whole = place + mcap_records.RECORD.size + length <= self._size
            if not whole:
                self._complain(
                    f"{self._path}: cut off or damaged at byte {place} of {self._size}; what is before is read"
                )
            if opcode == mcap_records.CHUNK:
                self._scan_chunk(contents, place, min(mcap_records.RECORD.size + length, self._size - place))
            elif whole:
                self._scan_record(contents, opcode, place, length)
            if not whole:
                return contents
            place += mcap_records.RECORD.size + length
        return contents

    def _scan_record(self, contents: FileContents, opcode: int, place: int, length: int) -> None:
        if opcode in (mcap_records.SCHEMA, mcap_records.CHANNEL) and length <= SMALL_BYTES_MAX:
            try:
                contents.add(opcode, self._read(place + mcap_records.RECORD.size, length))
            except ValueError as error:
                self._complain(f"{self._path}: at byte {place}: {error}; left out")
        elif opcode == mcap_records.MESSAGE and mcap_records.MESSAGE_HEAD.size <= length <= MESSAGE_BYTES_MAX:
            head = self._read(place + mcap_records.RECORD.size, mcap_records.MESSAGE_HEAD.size)
            number, _, moment, _ = mcap_records.MESSAGE_HEAD.unpack(head)
            self._times.append(moment)
            self._channels.append(number)
            self._places.append(place)

    def _scan_chunk(self, contents: FileContents, place: int, length: int) -> None:
        chunk = ChunkPlace(0, 0, place, length)
        times: list[int] = []
        data = self._unpacked(chunk)
        for opcode, start, size in mcap_records.body_records(data):
            if opcode == mcap_records.MESSAGE and size >= mcap_records.MESSAGE_HEAD.size:
                times.append(mcap_records.MESSAGE_HEAD.unpack_from(data, start)[2])
            elif opcode in (mcap_records.SCHEMA, mcap_records.CHANNEL):
                try:
                    contents.add(opcode, data[start : start + size])
                except ValueError as error:
                    self._complain(f"{self._path}: in the chunk at byte {place}: {error}; left out")
        if times:
            contents.chunks.append(ChunkPlace(min(times), max(times), place, length))

    def _read_topics(self) -> tuple[list[BagTopic], dict[str, str], dict[int, str]]:
        topics: dict[str, BagTopic] = {}
        definitions: dict[str, str] = {}
        names: dict[int, str] = {}
        for number, channel in self._known.channels.items():
            schema = self._known.schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding != SERIALISATION:
                encoding = channel.message_encoding if schema is not None else "of no known type"
                self._complain(f"{self._path}: topic {channel.topic} is {encoding}; only {SERIALISATION} is read")
                continue
            names[number] = channel.topic
            topics.setdefault(
                channel.topic, topic(channel.topic, schema.name, channel.metadata.get("offered_qos_profiles", ""))
            )
            if schema.encoding == DEFINITION and schema.data:
                definitions[schema.name] = schema.data.decode("utf-8", errors="replace")
        return list(topics.values()), definitions, names

    # messages --------------------------------------------------------------------------------------------------------

    def _loose(self, numbers: set[int]) -> Iterator[StoredMessage]:
        """Messages outside of chunks."""
        order: Any = [i for i, number in enumerate(self._channels) if number in numbers]
        order.sort(key=self._times.__getitem__)
        for index in order:
            data = self._message(self._places[index], self._size, self._channels[index], self._times[index])
            if data is not None:
                yield self._times[index], self._channels[index], data

    def _message(self, place: int, end: int, number: int, moment: int) -> bytes | None:
        """The message whose record begins at `place`; None when another one or none is there."""
        ahead = self._read(place, min(_AHEAD, end - place))
        if len(ahead) < _HEAD:
            return None
        opcode, length = mcap_records.RECORD.unpack_from(ahead)
        channel, _, time, _ = mcap_records.MESSAGE_HEAD.unpack_from(ahead, mcap_records.RECORD.size)
        last = mcap_records.RECORD.size + length
        if opcode != mcap_records.MESSAGE or (channel, time) != (number, moment) or place + last > end or last < _HEAD:
            return None
        if last <= len(ahead):
            return ahead[_HEAD:last]
        return ahead[_HEAD:] + self._read(place + len(ahead), last - len(ahead))

    def _chunk(self, chunk: ChunkPlace, numbers: set[int], everything: bool) -> list[StoredMessage]:
        """The wanted messages of a chunk in the order of their times."""
        messages = None if everything or not chunk.indexes else self._by_index(chunk, numbers)
        if messages is None:
            data = self._unpacked(chunk)
            messages = [
                (moment, number, bytes(data[start + mcap_records.MESSAGE_HEAD.size : start + size]))
                for opcode, start, size in mcap_records.body_records(data)
                if opcode == mcap_records.MESSAGE and size >= mcap_records.MESSAGE_HEAD.size
                for number, _, moment, _ in (mcap_records.MESSAGE_HEAD.unpack_from(data, start),)
                if number in numbers
            ]
        messages.sort(key=_moment)
        return messages

    def _by_index(self, chunk: ChunkPlace, numbers: set[int]) -> list[StoredMessage] | None:
        """The wanted messages alone, of a chunk that is not compressed; None when its index does not lead to them."""
        head = self._read(chunk.start, min(chunk.length, 256))
        try:
            _, _, kind, place, stored = mcap_records.chunk_head(head[mcap_records.RECORD.size :])
        except ValueError:
            return None
        start = chunk.start + mcap_records.RECORD.size + place
        if kind or start + stored > self._size:
            return None
        messages: list[StoredMessage] = []
        for number in sorted(numbers & set(chunk.indexes)):
            for moment, offset in self._index(chunk.indexes[number], number):
                data = self._message(start + offset, start + stored, number, moment) if offset < stored else None
                if data is None:
                    return None
                messages.append((moment, number, data))
        return messages

    def _index(self, place: int, number: int) -> Iterator[tuple[int, int]]:
        """Log times and places of a channel's messages; a wrong index gives one that leads nowhere."""
        wrong = iter([(0, 1 << 63)])
        head = self._read(place, mcap_records.RECORD.size + mcap_records.INDEX_HEAD.size)
        if len(head) < mcap_records.RECORD.size + mcap_records.INDEX_HEAD.size:
            return wrong
        opcode, length = mcap_records.RECORD.unpack_from(head)
        channel, size = mcap_records.INDEX_HEAD.unpack_from(head, mcap_records.RECORD.size)
        fits = size + mcap_records.INDEX_HEAD.size == length and size % mcap_records.INDEX_ENTRY.size == 0
        if opcode != mcap_records.MESSAGE_INDEX or channel != number or not fits or place + length > self._size:
            return wrong
        return mcap_records.INDEX_ENTRY.iter_unpack(self._read(place + len(head), size))

    def _unpacked(self, chunk: ChunkPlace) -> bytes:
        """The records of a chunk; fewer where it is cut off, none where it is damaged."""
        where = f"{self._path}: the chunk at byte {chunk.start}"
        if not 0 < chunk.length <= CHUNK_BYTES_MAX or chunk.start + chunk.length > self._size:
            self._complain(f"{where} is damaged or larger than {CHUNK_BYTES_MAX} bytes; left out")
            return b""
        record = self._read(chunk.start, chunk.length)
        try:
            if record[0] != mcap_records.CHUNK:
                raise ValueError("there is none")
            body = record[mcap_records.RECORD.size :]
            size, checksum, kind, place, stored = mcap_records.chunk_head(body)
            if size > CHUNK_BYTES_MAX:
                raise ValueError(f"{size} bytes are more than {CHUNK_BYTES_MAX}")
            data = unpack(kind, body[place : place + stored], size)
        except ValueError as error:
            self._complain(f"{where} cannot be read ({error}); left out")
            return b""
        if len(body) < place + stored:
            return data
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            self._complain(f"{where} does not fit its checksum; left out")
            return b""
        return data

    def _read(self, place: int, length: int) -> bytes:
        try:
            return os.pread(self._file.fileno(), length, place) if length > 0 else b""
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read: {error.strerror}") from error


def _moment(message: StoredMessage) -> int:
    return message[0]
