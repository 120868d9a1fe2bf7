"""Writes MCAP files in chunks with an index, and rosbag2 folders of one such file, as ros2 and Foxglove read them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, IndexType, Writer

from robotkube.errors import InputError
from robotkube.robots.bags.core.playback import BagTopic

FILE = "bag.mcap"
SCHEMA_ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
CHUNK_BYTES = 1024 * 1024
VERSION = 9
DISTRIBUTION = "jazzy"
_ENDLESS = {"sec": 9223372036, "nsec": 854775807}


class BagWriter:
    """One file `name` in the new `folder`; `finish` writes metadata.yaml beside it when it shall be a rosbag2 folder.

    `definitions`: type -> its definition, as far as it is known. InputError when it cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[BagTopic],
        name: str = FILE,
        definitions: Mapping[str, str] | None = None,
        compressed: bool = False,
    ) -> None:
        self._folder = folder
        self._name = name
        self._topics = topics
        self.counts = {topic.name: 0 for topic in topics}
        self._first = self._last = 0
        try:
            folder.mkdir(parents=True)
            self._file = (folder / name).open("wb")
        except OSError as error:
            raise InputError(f"{folder}: the bag cannot be written: {error}; give a new folder") from error
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        self._writer = Writer(
            self._file, chunk_size=CHUNK_BYTES, compression=compression, index_types=IndexType.ALL, enable_crcs=True
        )
        self._writer.start(profile="ros2", library="robotkube")
        self._channels = {topic.name: self._channel(topic, definitions or {}) for topic in topics}

    def add(self, topic: str, moment: int, data: bytes, stamp: int | None = None) -> None:
        """Add a message that was recorded at `moment` and published at `stamp` (ns); the file need not be in order."""
        number = self.counts[topic]
        try:
            self._writer.add_message(
                self._channels[topic], moment, data, moment if stamp is None else stamp, number & 0xFFFFFFFF
            )
        except OSError as error:
            raise InputError(f"{self._folder}: the bag cannot be written: {error.strerror}") from error
        self.counts[topic] = number + 1
        self._first = min(self._first, moment) if sum(self.counts.values()) > 1 else moment
        self._last = max(self._last, moment)

    def finish(self, metadata: bool = True) -> None:
        """Write the index, and metadata.yaml; nothing more is added."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
            if metadata:
                (self._folder / "metadata.yaml").write_text(self._metadata(), encoding="utf-8")
        except OSError as error:
            raise InputError(f"{self._folder}: the bag cannot be written: {error}") from error

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with suppress(OSError):
            self._file.close()

    def _channel(self, topic: BagTopic, definitions: Mapping[str, str]) -> int:
        import yaml

        text = definitions.get(topic.type, "")
        schema = self._writer.register_schema(topic.type, SCHEMA_ENCODING, text.encode())
        profiles = {"offered_qos_profiles": yaml.safe_dump([_qos_profile(topic)], sort_keys=False)}
        return int(self._writer.register_channel(topic.name, MESSAGE_ENCODING, schema, profiles))

    def _metadata(self) -> str:
        """metadata.yaml of rosbag2, version 9."""
        import yaml

        count = sum(self.counts.values())
        begin = {"nanoseconds_since_epoch": self._first}
        duration = {"nanoseconds": self._last - self._first}
        topics = [{"topic_metadata": _topic(topic), "message_count": self.counts[topic.name]} for topic in self._topics]
        information = {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": begin,
            "message_count": count,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [
                {
                    "path": self._name,
                    "starting_time": dict(begin),
                    "duration": dict(duration),
                    "message_count": count,
                }
            ],
            "custom_data": None,
            "ros_distro": DISTRIBUTION,
        }
        return str(yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False))


def write_bag(folder: Path, topics: Sequence[BagTopic], messages: Iterable[tuple[str, int, bytes]]) -> None:
    """Write messages (topic, offset in ns, serialised message), as a player plays them, into the new `folder`;
    InputError when it cannot be written."""
    with BagWriter(folder, topics) as writer:
        for name, offset, data in messages:
            writer.add(name, offset, data)
        writer.finish()


def _topic(topic: BagTopic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type,
        "serialization_format": MESSAGE_ENCODING,
        "offered_qos_profiles": [_qos_profile(topic)],
        "type_description_hash": "",
    }


def _qos_profile(topic: BagTopic) -> dict[str, Any]:
    """The QoS profile in the words of rosbag2, version 9."""
    return {
        "history": "keep_last",
        "depth": topic.depth,
        "reliability": topic.reliability,
        "durability": topic.durability,
        "deadline": dict(_ENDLESS),
        "lifespan": dict(_ENDLESS),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_ENDLESS),
        "avoid_ros_namespace_conventions": False,
    }
