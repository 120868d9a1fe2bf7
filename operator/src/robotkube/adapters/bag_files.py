"""rosbag2 folders with one uncompressed MCAP file, read chunk by chunk, and the ledgers a player writes.

The mcap package reads the index; the messages of a chunk are cut out here, because its reader makes an object per
message. One chunk is in memory at a time (about 1 MB in bags of our generator, CHUNK_BYTES_MAX at most).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from robotkube.domain.bags import BagTopic, LedgerState, ledger_name, read_ledger
from robotkube.domain.errors import InputError

CHUNK_BYTES_MAX = 256 * 1024 * 1024
LEDGER_BYTES_MAX = 1024 * 1024 * 1024
CHANNEL, MESSAGE = 0x04, 0x05
SERIALISATION = "cdr"
DEPTH_DEFAULT = 10

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_LENGTH = struct.Struct("<I")
_SIZE = struct.Struct("<Q")
_RELIABILITIES = {"1": "reliable", "2": "best_effort"}
_DURABILITIES = {"1": "transient_local", "2": "volatile"}


class BagFile:
    """A bag; InputError at construction says what is wrong with the folder."""

    def __init__(self, folder: Path) -> None:
        self.path = _mcap_file(folder)
        self._file = self._open()
        try:
            self._read_summary()
        except InputError:
            self._file.close()
            raise

    def _read_summary(self) -> None:
        summary = _summary(self._file, self.path)
        self._chunks = sorted(
            summary.chunk_indexes, key=lambda chunk: (chunk.message_start_time, chunk.message_end_time)
        )
        self._names = {number: channel.topic for number, channel in summary.channels.items()}
        self.topics: Sequence[BagTopic] = [_topic(c, summary, self.path) for c in summary.channels.values()]
        compressed = [chunk.compression for chunk in self._chunks if chunk.compression]
        if compressed:
            raise InputError(f"{self.path}: chunks are compressed ({compressed[0]}); write the bag without compression")

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def _open(self) -> BinaryIO:
        try:
            return self.path.open("rb")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read ({error}); metadata.yaml names it") from error

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """See the port."""
        last = -1
        for chunk in self._chunks:
            for number, moment, data in self._chunk_messages(chunk):
                if moment < last:
                    raise InputError(f"{self.path}: messages are not in the order of their times; sort the bag")
                last = moment
                yield self._names[number], moment, data

    def _chunk_messages(self, index: Any) -> Iterator[tuple[int, int, bytes]]:
        if index.chunk_length > CHUNK_BYTES_MAX:
            raise InputError(f"{self.path}: a chunk of {index.chunk_length} bytes is larger than {CHUNK_BYTES_MAX}")
        records = self._records(os.pread(self._file.fileno(), index.chunk_length, index.chunk_start_offset))
        place, end = 0, len(records)
        while place < end:
            opcode, length = _RECORD.unpack_from(records, place)
            place += _RECORD.size
            if opcode == MESSAGE:
                number, _, moment, _ = _MESSAGE.unpack_from(records, place)
                yield number, moment, bytes(records[place + _MESSAGE.size : place + length])
            place += length

    def _records(self, chunk: bytes) -> memoryview:
        try:
            _, _, size, checksum = _CHUNK.unpack_from(chunk, _RECORD.size)
            place = _RECORD.size + _CHUNK.size
            place += _LENGTH.size + _LENGTH.unpack_from(chunk, place)[0]
            stored = _SIZE.unpack_from(chunk, place)[0]
            records = memoryview(chunk)[place + _SIZE.size : place + _SIZE.size + stored]
        except struct.error as error:
            raise InputError(f"{self.path}: a chunk is cut off; make the bag again") from error
        if len(records) != size or (checksum and zlib.crc32(records) != checksum):
            raise InputError(f"{self.path}: a chunk is damaged; make the bag again")
        return records


def _mcap_file(folder: Path) -> Path:
    import yaml

    metadata = folder / "metadata.yaml"
    try:
        information = yaml.safe_load(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        storage, names = information["storage_identifier"], information["relative_file_paths"]
    except OSError as error:
        raise InputError(f"{metadata}: cannot be read ({error}); `bag` must name a rosbag2 folder") from error
    except (yaml.YAMLError, KeyError, TypeError) as error:
        raise InputError(f"{metadata}: is not the metadata of a rosbag2 bag: {error}") from error
    if storage != "mcap" or len(names) != 1:
        raise InputError(f"{metadata}: storage {storage} in {len(names)} files; give a bag of one MCAP file")
    return folder / str(names[0])


def _summary(file: BinaryIO, path: Path) -> Any:
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        summary = make_reader(file).get_summary()
    except (McapError, OSError, struct.error, ValueError) as error:
        raise InputError(f"{path}: is not a whole MCAP file: {error}; make the bag again") from error
    if summary is None or not summary.chunk_indexes:
        raise InputError(f"{path}: has no chunk index; write the bag with one")
    return summary


def _topic(channel: Any, summary: Any, path: Path) -> BagTopic:
    if channel.message_encoding != SERIALISATION:
        raise InputError(f"{path}: topic {channel.topic} is {channel.message_encoding}; only {SERIALISATION} is played")
    quality = _quality(channel.metadata.get("offered_qos_profiles", ""))
    return BagTopic(
        name=channel.topic,
        type=summary.schemas[channel.schema_id].name,
        reliability=_RELIABILITIES.get(str(quality.get("reliability")), str(quality.get("reliability", "reliable"))),
        durability=_DURABILITIES.get(str(quality.get("durability")), str(quality.get("durability", "volatile"))),
        depth=int(quality.get("depth") or DEPTH_DEFAULT),
    )


def _quality(text: str) -> dict[str, Any]:
    """The first offered profile; rosbag2 writes words (version 9) or numbers (before)."""
    import yaml

    profiles = yaml.safe_load(text) if text else None
    return profiles[0] if isinstance(profiles, list) and profiles and isinstance(profiles[0], dict) else {}


class LedgerFiles:
    """Ledgers below `folder`: `<run>/<topic with / as __>.jsonl`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, BinaryIO] = {}
        self._lines: dict[str, list[str]] = {}

    def open(self, run: str, topic: str) -> LedgerState:
        """See the port."""
        path = self._folder / run / ledger_name(topic)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("ab+", buffering=0)
            file.seek(0)
            state = read_ledger(file.read(LEDGER_BYTES_MAX))
            file.truncate(state.whole_bytes)
            file.seek(0, os.SEEK_END)
        except OSError as error:
            raise InputError(f"{path}: the ledger cannot be written: {error}; see `ledger` and its volume") from error
        self._files[topic], self._lines[topic] = file, []
        return state

    def append(self, topic: str, line: str) -> None:
        """See the port."""
        self._lines[topic].append(line)

    def flush(self) -> None:
        """See the port."""
        for topic, lines in self._lines.items():
            if lines:
                data, written = "".join(lines).encode("ascii"), 0
                while written < len(data):
                    written += self._files[topic].write(data[written:])
                lines.clear()

    def close(self) -> None:
        """See the port."""
        self.flush()
        for file in self._files.values():
            file.close()
        self._files.clear()
        self._lines.clear()
