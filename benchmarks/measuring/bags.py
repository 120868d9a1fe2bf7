"""Small bags for measurements and tests: right rates and sizes, no meaning."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.writer import CompressionType, Writer

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
TRANSFORM_TYPE = "geometry_msgs/msg/TransformStamped"
CHUNK_BYTES = 1 << 20
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Track:
    """A topic that is published `hertz` times a second (0: once, at the beginning) with messages of `size` bytes."""

    name: str
    type: str
    hertz: int
    size: int
    offset: int = 0
    durability: str = "volatile"
    depth: int = 1000


def pose_track(agent: str) -> Track:
    """Poses of a vehicle at 100 Hz."""
    return Track(f"/vehicles/{agent.replace('-', '_')}/pose", POSE_TYPE, 100, 76)


def lidar_tracks(agent: str, size: int = 320_000) -> list[Track]:
    """Clouds at 10 Hz and the transform of a lidar."""
    base = f"/vehicles/{agent.replace('-', '_')}/lidar_center"
    return [
        Track(f"{base}/pointcloud", CLOUD_TYPE, 10, size, 5_000_000, depth=10),
        Track(f"{base}/transform", TRANSFORM_TYPE, 0, 120, durability="transient_local", depth=1),
    ]


def message(number: int, moment: int, size: int) -> bytes:
    """A serialised message that begins with std_msgs/Header and differs from every other one."""
    header = struct.pack("<4BiI", 0, 1, 0, 0, *divmod(moment, NANOSECONDS))
    body = struct.pack("<I4sQ", 4, b"map\0", number)
    return (header + body).ljust(size, b"\x5a")


def write_bag(folder: Path, tracks: list[Track], seconds: float) -> dict[str, int]:
    """A rosbag2 folder; returns the number of messages per topic."""
    folder.mkdir(parents=True)
    moments = []
    for track in tracks:
        period = NANOSECONDS // track.hertz if track.hertz else 0
        count = int(seconds * track.hertz) if track.hertz else 1
        moments += [(track.offset + k * period, track, k) for k in range(count)]
    moments.sort(key=lambda entry: entry[0])
    counts = dict.fromkeys((track.name for track in tracks), 0)
    with (folder / "bag.mcap").open("wb") as output:
        writer = Writer(output, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="robotkube")
        channels = {track.name: _channel(writer, track) for track in tracks}
        for moment, track, number in moments:
            data = message(number, moment, track.size)
            writer.add_message(channels[track.name], moment, data, moment, number)
            counts[track.name] += 1
        writer.finish()  # type: ignore[no-untyped-call]
    information = {"version": 9, "storage_identifier": "mcap", "relative_file_paths": ["bag.mcap"]}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
    return counts


def _channel(writer: Writer, track: Track) -> int:
    schema = writer.register_schema(track.type, "ros2msg", b"")
    quality = {"reliability": "reliable", "durability": track.durability, "history": "keep_last", "depth": track.depth}
    return int(writer.register_channel(track.name, "cdr", schema, {"offered_qos_profiles": yaml.safe_dump([quality])}))
