"""One rosbag2 folder (metadata.yaml and one uncompressed MCAP file) per player, kept under the user's cache.

Times in a bag are offsets from the start of the run in ns: log_time = publish_time = header.stamp = offset + k *
period.
"""

from __future__ import annotations

import hashlib
import heapq
import importlib.metadata
import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml
from mcap.writer import CompressionType, IndexType, Writer

from ci.folders import user_cache
from scenarios.definition import Parameters, Scenario, cloud_topic, pose_topic, ros_name, transform_topic
from scenarios.generator import messages, routes, scene

CLOUD_OFFSET_NS = 5_000_000  # between two poses
SEEN_M = 350.0  # a lidar 3 m above the ground sees no farther
CHUNK_BYTES = 1 << 20
CACHE_ENTRIES_MAX = 4
SOURCES = ("drives.py", "routes.py", "three_vehicles.py", "intersection.py", "scene.py", "messages.py", "bags.py")

Message = tuple[str, int, bytes]  # topic, time in ns, serialised message


@dataclass(frozen=True)
class Topic:
    """A topic as the bag declares it; `depth` is the history a publisher keeps."""

    name: str
    type_name: str
    durability: str
    depth: int


def topics_of(agent: str, lidar: bool) -> tuple[Topic, ...]:
    """The topics in a player's bag."""
    pose = Topic(pose_topic(agent), messages.POSE_TYPE, "volatile", 1000)
    if not lidar:
        return (pose,)
    return (
        pose,
        Topic(transform_topic(agent), messages.TRANSFORM_TYPE, "transient_local", 1),
        Topic(cloud_topic(agent), messages.CLOUD_TYPE, "volatile", 10),
    )


def make_bags(
    scenario: Scenario, cache: Path | None = None, progress: Callable[[str], None] = print
) -> Mapping[str, Path]:
    """Bag folders by agent, made if the cache does not hold them; interrupted work leaves nothing that looks like a
    bag."""
    root = (cache or user_cache()) / "bags"
    root.mkdir(parents=True, exist_ok=True)
    target = root / key(scenario.parameters)
    if target.is_dir():
        os.utime(target)
        progress(f"bags: cached in {target}")
    else:
        _make(scenario, root, target, progress)
        _forget_old(root, target)
    return {agent: target / agent for agent in scenario.players}


def key(parameters: Parameters) -> str:
    """Name of a set of bags: hash of the parameters, this generator's source and the libraries it uses."""
    digest = hashlib.sha256(json.dumps(asdict(parameters), sort_keys=True).encode())
    for name in SOURCES:
        digest.update(Path(__file__).with_name(name).read_bytes())
    for library in ("numpy", "mcap", "rosbags"):
        digest.update(importlib.metadata.version(library).encode())
    return digest.hexdigest()[:16]


def _make(scenario: Scenario, root: Path, target: Path, progress: Callable[[str], None]) -> None:
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="partial-", dir=root) as partial:
        for number, agent in enumerate(scenario.players):
            size = write_bag(Path(partial) / agent, scenario, number)
            progress(
                f"bags: {agent} {number + 1}/{len(scenario.players)}, {size / 1e6:.0f} MB, "
                f"{time.monotonic() - begin:.1f} s"
            )
        made = root / f"{Path(partial).name}.made"
        Path(partial).rename(made)
        Path(partial).mkdir()
    made.chmod(0o755)
    made.rename(target)


def _forget_old(root: Path, target: Path) -> None:
    """Keeps the latest sets of bags; leftovers of interrupted runs older than an hour go as well."""
    entries = sorted(
        (entry for entry in root.iterdir() if entry != target), key=lambda entry: entry.stat().st_mtime, reverse=True
    )
    hour_ago = time.time() - 3600
    partial = [entry for entry in entries if entry.name.startswith("partial-")]
    finished = [entry for entry in entries if not entry.name.startswith("partial-")]
    for entry in finished[CACHE_ENTRIES_MAX - 1 :] + [entry for entry in partial if entry.stat().st_mtime < hour_ago]:
        shutil.rmtree(entry, ignore_errors=True)


def write_bag(folder: Path, scenario: Scenario, number: int) -> int:
    """Writes the bag of player `number` into the new `folder`; returns its size in bytes."""
    parameters = scenario.parameters
    agent = scenario.players[number]
    lidar = agent in scenario.lidar_agents
    topics = topics_of(agent, lidar)
    folder.mkdir(parents=True)
    file = folder / f"{agent}.mcap"
    stream = _merged(_poses(parameters, agent, number), _lidar(parameters, agent, number) if lidar else iter(()))
    counts, last = _write_mcap(file, topics, stream)
    (folder / "metadata.yaml").write_text(_metadata(file.name, topics, counts, last))
    return file.stat().st_size


def _merged(first: Iterator[Message], second: Iterator[Message]) -> Iterator[Message]:
    return heapq.merge(first, second, key=lambda message: message[1])


def _grid(parameters: Parameters, hertz: int, offset: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    count = routes.duration_seconds(parameters) * hertz
    return offset + np.arange(count, dtype=np.int64) * (messages.NANOSECONDS // hertz)


def _poses(parameters: Parameters, agent: str, number: int) -> Iterator[Message]:
    stamps = _grid(parameters, parameters.pose_hz, 0)
    motion = routes.motion(parameters, number, stamps / messages.NANOSECONDS)
    writer = messages.PoseWriter()
    topic = pose_topic(agent)
    for stamp, x, y, yaw in zip(
        stamps.tolist(), motion.x.tolist(), motion.y.tolist(), motion.yaw.tolist(), strict=True
    ):
        yield topic, stamp, writer.message(stamp, x, y, yaw)


def _lidar(parameters: Parameters, agent: str, number: int) -> Iterator[Message]:
    """The transform at offset 0, then the clouds."""
    base = ros_name(agent)
    frame = f"{ros_name(agent)}/lidar_center"
    mount = _mount(parameters, number)
    rays = scene.ray_directions(parameters.points)
    yield transform_topic(agent), 0, messages.transform(0, base, frame, mount)
    stamps = _grid(parameters, parameters.point_cloud_hz, CLOUD_OFFSET_NS)
    own, *others = (
        routes.motion(parameters, index, stamps / messages.NANOSECONDS)
        for index in (number, *(index for index in range(parameters.vehicles) if index != number))
    )
    obstacles = routes.obstacles(parameters)
    writer = messages.CloudWriter(frame, len(rays))
    topic = cloud_topic(agent)
    random = np.random.default_rng(number)
    for index, stamp in enumerate(stamps.tolist()):
        noise = random.standard_normal(len(rays), np.float32) * np.float32(scene.NOISE_M)
        place = _place(own, index)
        near = [_place(other, index) for other in others if _within(place, _place(other, index))]
        yield topic, stamp, writer.message(stamp, scene.cast(rays, mount, place, near, noise, obstacles))


def _mount(parameters: Parameters, number: int) -> scene.Mount:
    return scene.MOUNTS[number % len(scene.MOUNTS)] if number < parameters.vehicles else scene.ROADSIDE_MOUNT


def _within(own: scene.Place, other: scene.Place) -> bool:
    """Return whether a box can be seen at all: rays end at the ground before SEEN_M."""
    return math.hypot(own.x - other.x, own.y - other.y) < SEEN_M


def _place(motion: routes.Motion, index: int) -> scene.Place:
    return scene.Place(float(motion.x[index]), float(motion.y[index]), float(motion.yaw[index]))


def _write_mcap(file: Path, topics: tuple[Topic, ...], stream: Iterator[Message]) -> tuple[dict[str, int], int]:
    """Writes all messages; returns their number per topic and the last time in ns."""
    counts = {topic.name: 0 for topic in topics}
    last = 0
    with file.open("wb") as output:
        writer = Writer(
            output,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.NONE,
            index_types=IndexType.ALL,
            enable_crcs=True,
        )
        writer.start(profile="ros2", library="robotkube")
        channels = {topic.name: _register(writer, topic) for topic in topics}
        for topic, moment, data in stream:
            writer.add_message(channels[topic], moment, data, moment, counts[topic] & 0xFFFFFFFF)
            counts[topic] += 1
            last = moment
        writer.finish()  # type: ignore[no-untyped-call]
    return counts, last


def _register(writer: Writer, topic: Topic) -> int:
    kind = messages.definition(topic.type_name)
    schema = writer.register_schema(kind.name, "ros2msg", kind.text.encode())
    profiles = yaml.safe_dump([_qos_profile(topic)], sort_keys=False)
    return int(
        writer.register_channel(
            topic.name, "cdr", schema, {"offered_qos_profiles": profiles, "topic_type_hash": kind.type_hash}
        )
    )


def _qos_profile(topic: Topic) -> dict[str, object]:
    """The QoS profile in the keys of rosbag2, version 9."""
    endless = {"sec": 9223372036, "nsec": 854775807}
    return {
        "history": "keep_last",
        "depth": topic.depth,
        "reliability": "reliable",
        "durability": topic.durability,
        "deadline": dict(endless),
        "lifespan": dict(endless),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(endless),
        "avoid_ros_namespace_conventions": False,
    }


def _metadata(file: str, topics: tuple[Topic, ...], counts: Mapping[str, int], last: int) -> str:
    """metadata.yaml of rosbag2, version 9."""
    span = {
        "starting_time": {"nanoseconds_since_epoch": 0},
        "duration": {"nanoseconds": last},
        "message_count": sum(counts.values()),
    }
    return yaml.safe_dump(
        {
            "rosbag2_bagfile_information": {
                "version": 9,
                "storage_identifier": "mcap",
                "relative_file_paths": [file],
                **span,
                "topics_with_message_count": [
                    {"topic_metadata": _topic_metadata(topic), "message_count": counts[topic.name]} for topic in topics
                ],
                "compression_format": "",
                "compression_mode": "",
                "files": [{"path": file, **json.loads(json.dumps(span))}],
                "custom_data": None,
                "ros_distro": "jazzy",
            }
        },
        sort_keys=False,
    )


def _topic_metadata(topic: Topic) -> dict[str, object]:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": [_qos_profile(topic)],
        "type_description_hash": messages.definition(topic.type_name).type_hash,
    }
