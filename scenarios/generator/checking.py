"""Checking of bags: the right topics and types, every stamp on the grid. Run before anything is started."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader

from scenarios.definition import Scenario, ScenarioError, pose_topic
from scenarios.generator import bags, messages

METADATA_BYTES_MAX = 1_000_000


def check_bag(folder: Path, scenario: Scenario, agent: str) -> None:
    """Raises `ScenarioError` naming file, topic and fix for a bag that is not what `agent` needs."""
    file = _data_file(folder)
    topics = bags.topics_of(agent, agent in scenario.lidar_agents)
    try:
        with file.open("rb") as stream:
            _check_file(file, stream, topics, scenario, agent)
    except McapError as error:
        raise ScenarioError(
            f"{file}: not a complete MCAP file ({error or type(error).__name__}); remove {folder} and make it again"
        ) from error


def _data_file(folder: Path) -> Path:
    metadata = folder / "metadata.yaml"
    if not metadata.is_file() or metadata.stat().st_size > METADATA_BYTES_MAX:
        raise ScenarioError(
            f"{metadata}: missing or too large, so {folder} is no rosbag2 folder; give the folder that holds "
            f"metadata.yaml"
        )
    try:
        information = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
        storage, files = information["storage_identifier"], information["relative_file_paths"]
    except (yaml.YAMLError, KeyError, TypeError) as error:
        raise ScenarioError(
            f"{metadata}: rosbag2_bagfile_information: incomplete ({error!r}); write it again with `ros2 bag reindex`"
        ) from error
    if storage != "mcap" or len(files) != 1 or information.get("compression_mode"):
        raise ScenarioError(
            f"{metadata}: storage_identifier, relative_file_paths: one uncompressed MCAP file is needed; convert "
            f"with `ros2 bag convert`"
        )
    file = folder / str(files[0])
    if not file.is_file():
        raise ScenarioError(f"{metadata}: relative_file_paths: {files[0]} is not there; put it beside metadata.yaml")
    return file


def _check_file(file: Path, stream: Any, topics: tuple[bags.Topic, ...], scenario: Scenario, agent: str) -> None:
    reader = make_reader(stream)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ScenarioError(f"{file}: has no summary, so it was not finished; write the bag again")
    types = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    for topic in topics:
        if topic.name not in types:
            raise ScenarioError(
                f"{file}: topic {topic.name} is missing (there are: {', '.join(sorted(types)) or 'none'}); record "
                f"or rename it"
            )
        if types[topic.name] != topic.type_name:
            raise ScenarioError(
                f"{file}: topic {topic.name} has type {types[topic.name]}; it must be {topic.type_name}"
            )
    for topic in topics:
        _check_grid(file, reader, topic.name, _period(topic, scenario, agent))


def _period(topic: bags.Topic, scenario: Scenario, agent: str) -> int | None:
    """Nanoseconds between two messages; None for a topic that is sent once."""
    if topic.durability == "transient_local":
        return None
    hertz = scenario.parameters.pose_hz if topic.name == pose_topic(agent) else scenario.parameters.point_cloud_hz
    return messages.NANOSECONDS // hertz


def _check_grid(file: Path, reader: Any, topic: str, period: int | None) -> None:
    """Message k must have log_time = publish_time = header.stamp = first + k * period."""
    first: int | None = None
    count = 0
    for _, _, message in reader.iter_messages(topics=[topic]):
        first = message.log_time if first is None else first
        due = first + count * (period or 0)
        stamp = messages.stamp_of(message.data)
        if not due == message.log_time == message.publish_time == stamp:
            raise ScenarioError(
                f"{file}: topic {topic}: message {count} has log_time {message.log_time}, publish_time "
                f"{message.publish_time} and stamp {stamp} ns, "
                f"but the grid asks for {due}; resample the topic to offset + k * {period or 0} ns"
            )
        count += 1
    if count == 0 or (period is None and count != 1):
        raise ScenarioError(
            f"{file}: topic {topic} has {count} messages; {'exactly one' if period is None else 'at least one'} is "
            f"needed"
        )
