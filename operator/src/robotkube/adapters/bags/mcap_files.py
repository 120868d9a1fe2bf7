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

from robotkube.adapters.bags import mcap_records as records
from robotkube.adapters.bags.compression import unpack
from robotkube.adapters.bags.mcap_records import ChunkPlace, Described
from robotkube.adapters.bags.metadata import topic
from robotkube.domain.bags import BagTopic
from robotkube.domain.errors import InputError

CHUNK_BYTES_MAX = 256 * 1024 * 1024
SUMMARY_BYTES_MAX = 256 * 1024 * 1024
SMALL_BYTES_MAX = 16 * 1024 * 1024
MESSAGE_BYTES_MAX = 1024 * 1024 * 1024
OPEN_BYTES_MAX = 512 * 1024 * 1024
SERIALISATION, DEFINITION = "cdr", "ros2msg"
_AHEAD = 4096
_HEAD = records.RECORD.size + records.MESSAGE_HEAD.size

Found = tuple[int, int, bytes]
"""Log time in ns, channel and serialised message."""


class McapFile:
    """InputError at construction: not a file of this kind. `complain` hears of damage, of the file as `named`."""

    def __init__(self, path: Path, complain: Callable[[str], None], named: Path | None = None) -> None:
        self._path, self._complain = named or path, complain
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror})") from error
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._times, self._channels, self._places = array("Q"), array("H"), array("Q")
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
        sources: list[tuple[int, int, Iterator[Found], Found]] = []
        self._enter(sources, -1, self._loose(numbers))
        chunks = sorted(
            (c for c in self._known.chunks if not c.indexes or not numbers.isdisjoint(c.indexes)),
            key=lambda chunk: (chunk.first, chunk.start),
        )
        position, held = 0, {}
        while sources or position < len(chunks):
            while position < len(chunks) and (not sources or chunks[position].first <= sources[0][0]):
                found = self._chunk(chunks[position], numbers, everything)
                held[position] = sum(len(data) for _, _, data in found)
                if sum(held.values()) > OPEN_BYTES_MAX:
                    raise InputError(f"{self._path}: its messages are in no order at all; sort it: `ros2 bag convert`")
                self._enter(sources, position, iter(found))
                position += 1
            if not sources:
                continue
            _, order, source, (moment, number, data) = heappop(sources)
            yield self._names[number], moment, data
            if not self._enter(sources, order, source):
                held.pop(order, None)

    @staticmethod
    def _enter(sources: list[Any], order: int, source: Iterator[Found]) -> bool:
        following = next(source, None)
        if following is None:
            return False
        heappush(sources, (following[0], order, source, following))
        return True

    # what is in the file ---------------------------------------------------------------------------------------------

    def _describe(self) -> Described:
        if self._read(0, len(records.MAGIC)) != records.MAGIC:
            raise InputError(f"{self._path}: is no MCAP file")
        try:
            found = self._summary()
        except (ValueError, struct.error) as error:
            self._complain(f"{self._path}: {error}; read without it, as far as it goes")
            return self._scan()
        return found if found is not None and found.whole else self._scan()

    def _summary(self) -> Described | None:
        """None when the file has none; ValueError when it is cut off or damaged."""
        footer_length = records.RECORD.size + records.FOOTER_BODY.size
        footer_at = self._size - len(records.MAGIC) - footer_length
        if footer_at < len(records.MAGIC) or self._read(self._size - len(records.MAGIC), 8) != records.MAGIC:
            raise ValueError("its end is missing, so it was not finished or is cut off")
        footer = self._read(footer_at, footer_length)
        if records.RECORD.unpack_from(footer) != (records.FOOTER, records.FOOTER_BODY.size):
            raise ValueError("its footer is damaged")
        start, _, _ = records.FOOTER_BODY.unpack_from(footer, records.RECORD.size)
        if start == 0:
            return None
        if not len(records.MAGIC) <= start <= footer_at or footer_at - start > SUMMARY_BYTES_MAX:
            raise ValueError("its footer is damaged")
        return records.read_summary(self._read(start, footer_at - start), footer)

    def _scan(self) -> Described:
        """Go through all records, up to the first that is not whole."""
        found, place = Described(), len(records.MAGIC)
        while place + records.RECORD.size <= self._size:
            opcode, length = records.RECORD.unpack(self._read(place, records.RECORD.size))
            if opcode == records.DATA_END:
                return found
            whole = place + records.RECORD.size + length <= self._size
            if not whole:
                self._complain(
                    f"{self._path}: cut off or damaged at byte {place} of {self._size}; what is before is read"
                )
            if opcode == records.CHUNK:
                self._scan_chunk(found, place, min(records.RECORD.size + length, self._size - place))
            elif whole:
                self._scan_record(found, opcode, place, length)
            if not whole:
                return found
            place += records.RECORD.size + length
        return found

    def _scan_record(self, found: Described, opcode: int, place: int, length: int) -> None:
        if opcode in (records.SCHEMA, records.CHANNEL) and length <= SMALL_BYTES_MAX:
            try:
                found.take(opcode, self._read(place + records.RECORD.size, length))
            except ValueError as error:
                self._complain(f"{self._path}: at byte {place}: {error}; left out")
        elif opcode == records.MESSAGE and records.MESSAGE_HEAD.size <= length <= MESSAGE_BYTES_MAX:
            head = self._read(place + records.RECORD.size, records.MESSAGE_HEAD.size)
            number, _, moment, _ = records.MESSAGE_HEAD.unpack(head)
            self._times.append(moment)
            self._channels.append(number)
            self._places.append(place)

    def _scan_chunk(self, found: Described, place: int, length: int) -> None:
        chunk = ChunkPlace(0, 0, place, length)
        times: list[int] = []
        data = self._unpacked(chunk)
        for opcode, start, size in records.body_records(data):
            if opcode == records.MESSAGE and size >= records.MESSAGE_HEAD.size:
                times.append(records.MESSAGE_HEAD.unpack_from(data, start)[2])
            elif opcode in (records.SCHEMA, records.CHANNEL):
                try:
                    found.take(opcode, data[start : start + size])
                except ValueError as error:
                    self._complain(f"{self._path}: in the chunk at byte {place}: {error}; left out")
        if times:
            found.chunks.append(ChunkPlace(min(times), max(times), place, length))

    def _read_topics(self) -> tuple[list[BagTopic], dict[str, str], dict[int, str]]:
        topics: dict[str, BagTopic] = {}
        definitions, names = {}, {}
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

    def _loose(self, numbers: set[int]) -> Iterator[Found]:
        """Messages outside of chunks."""
        order: Any = [i for i, number in enumerate(self._channels) if number in numbers]
        order.sort(key=self._times.__getitem__)
        for index in order:
            data = self._message(self._places[index], self._size, self._channels[index], self._times[index])
            if data is not None:
                yield self._times[index], self._channels[index], data

    def _message(self, place: int, end: int, number: int, moment: int) -> bytes | None:
        """The message whose record begins at `place`; None when there is not this one."""
        ahead = self._read(place, min(_AHEAD, end - place))
        if len(ahead) < _HEAD:
            return None
        opcode, length = records.RECORD.unpack_from(ahead)
        found, _, time, _ = records.MESSAGE_HEAD.unpack_from(ahead, records.RECORD.size)
        last = records.RECORD.size + length
        if opcode != records.MESSAGE or found != number or time != moment or place + last > end or last < _HEAD:
            return None
        if last <= len(ahead):
            return ahead[_HEAD:last]
        return ahead[_HEAD:] + self._read(place + len(ahead), last - len(ahead))

    def _chunk(self, chunk: ChunkPlace, numbers: set[int], everything: bool) -> list[Found]:
        """The wanted messages of a chunk in the order of their times."""
        found = None if everything or not chunk.indexes else self._by_index(chunk, numbers)
        if found is None:
            data = self._unpacked(chunk)
            found = [
                (moment, number, bytes(data[start + records.MESSAGE_HEAD.size : start + size]))
                for opcode, start, size in records.body_records(data)
                if opcode == records.MESSAGE and size >= records.MESSAGE_HEAD.size
                for number, _, moment, _ in (records.MESSAGE_HEAD.unpack_from(data, start),)
                if number in numbers
            ]
        found.sort(key=_moment)
        return found

    def _by_index(self, chunk: ChunkPlace, numbers: set[int]) -> list[Found] | None:
        """Only the wanted messages of a chunk that is not compressed; None when its index does not lead to them."""
        head = self._read(chunk.start, min(chunk.length, 256))
        try:
            _, _, kind, place, stored = records.chunk_head(head[records.RECORD.size :])
        except ValueError:
            return None
        start = chunk.start + records.RECORD.size + place
        if kind or start + stored > self._size:
            return None
        found: list[Found] = []
        for number in sorted(numbers & set(chunk.indexes)):
            for moment, offset in self._index(chunk.indexes[number], number):
                data = self._message(start + offset, start + stored, number, moment) if offset < stored else None
                if data is None:
                    return None
                found.append((moment, number, data))
        return found

    def _index(self, place: int, number: int) -> Iterator[tuple[int, int]]:
        """Log times and places of a channel's messages; a wrong index gives one that leads nowhere."""
        wrong = iter([(0, 1 << 63)])
        head = self._read(place, records.RECORD.size + records.INDEX_HEAD.size)
        if len(head) < records.RECORD.size + records.INDEX_HEAD.size:
            return wrong
        opcode, length = records.RECORD.unpack_from(head)
        found, size = records.INDEX_HEAD.unpack_from(head, records.RECORD.size)
        fits = size + records.INDEX_HEAD.size == length and size % records.INDEX_ENTRY.size == 0
        if opcode != records.MESSAGE_INDEX or found != number or not fits or place + length > self._size:
            return wrong
        return records.INDEX_ENTRY.iter_unpack(self._read(place + len(head), size))

    def _unpacked(self, chunk: ChunkPlace) -> bytes:
        """The records of a chunk; fewer where it is cut off, none where it is damaged."""
        where = f"{self._path}: the chunk at byte {chunk.start}"
        if not 0 < chunk.length <= CHUNK_BYTES_MAX or chunk.start + chunk.length > self._size:
            self._complain(f"{where} is damaged or larger than {CHUNK_BYTES_MAX} bytes; left out")
            return b""
        record = self._read(chunk.start, chunk.length)
        try:
            if record[0] != records.CHUNK:
                raise ValueError("there is none")
            body = record[records.RECORD.size :]
            size, checksum, kind, place, stored = records.chunk_head(body)
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


def _moment(found: Found) -> int:
    return found[0]
