"""Writes a bag as the player plays it: a rosbag2 folder with one MCAP file of chunks without compression."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from mcap.writer import CompressionType, Writer

from robotkube.domain.bags import BagTopic
from robotkube.domain.errors import InputError

FILE = "bag.mcap"
SCHEMA_ENCODING, MESSAGE_ENCODING = "ros2msg", "cdr"


def write_bag(folder: Path, topics: Sequence[BagTopic], messages: Iterable[tuple[str, int, bytes]]) -> None:
    """Topic, offset in ns and serialised message, offsets ascending, into the new `folder`; InputError when it cannot
    be written."""
    try:
        folder.mkdir(parents=True)
        with (folder / FILE).open("wb") as output:
            writer = Writer(output, compression=CompressionType.NONE)
            writer.start(profile="ros2", library="robotkube")
            channels = {topic.name: _channel(writer, topic) for topic in topics}
            for name, offset, data in messages:
                writer.add_message(channels[name], offset, data, offset)
            writer.finish()  # type: ignore[no-untyped-call]
        (folder / "metadata.yaml").write_text(_metadata())
    except OSError as error:
        raise InputError(f"{folder}: the bag cannot be written: {error}; give a new folder") from error


def _channel(writer: Writer, topic: BagTopic) -> int:
    import yaml

    quality = {
        "reliability": topic.reliability,
        "durability": topic.durability,
        "history": "keep_last",
        "depth": topic.depth,
    }
    schema = writer.register_schema(topic.type, SCHEMA_ENCODING, b"")
    profiles = {"offered_qos_profiles": yaml.safe_dump([quality])}
    return int(writer.register_channel(topic.name, MESSAGE_ENCODING, schema, profiles))


def _metadata() -> str:
    import yaml

    information = {"version": 9, "storage_identifier": "mcap", "relative_file_paths": [FILE]}
    return yaml.safe_dump({"rosbag2_bagfile_information": information})
