"""Writes a small bag of one vehicle without meaning: `python3 -m robotkube.robots.bags.sample_bag AGENT FOLDER`.

For the suites: what a vehicle with one lidar publishes, two seconds of it, every message at its defaults. Needs the
packages of the messages, so it runs in the image that plays the bag.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from robotkube.errors import InputError
from robotkube.foundation.runtime.process import Process, run
from robotkube.robots.bags.adapters.writing import write_bag
from robotkube.robots.bags.core.playback import BagTopic
from robotkube.robots.ros.adapters.message_classes import default_message
from robotkube.robots.ros.core.topic_patterns import ros_name

SECONDS = 2
NANOSECONDS = 1_000_000_000
GRACE_SECONDS = 1.0
RATES = {"pose": 10, "lidar_center/pointcloud": 2}


def body(process: Process) -> None:
    """Write the bag; InputError for wrong arguments and a folder that is there already."""
    if len(sys.argv) != 3:
        raise InputError("give two arguments: the agent and a folder that is made")
    topics = sample_topics(sys.argv[1])
    folder = Path(sys.argv[2])
    write_bag(folder, topics, messages(topics))
    process.log("written", folder=str(folder), topics=[topic.name for topic in topics])


def sample_topics(agent: str) -> tuple[BagTopic, ...]:
    """Pose, point cloud and transform of an agent."""
    base = f"/vehicles/{ros_name(agent)}"
    return (
        BagTopic(f"{base}/pose", "geometry_msgs/msg/PoseStamped", "reliable", "volatile", 1000),
        BagTopic(f"{base}/lidar_center/pointcloud", "sensor_msgs/msg/PointCloud2", "reliable", "volatile", 10),
        BagTopic(
            f"{base}/lidar_center/transform", "geometry_msgs/msg/TransformStamped", "reliable", "transient_local", 1
        ),
    )


def messages(topics: tuple[BagTopic, ...]) -> Iterator[tuple[str, int, bytes]]:
    """The messages in the order of their times; a topic without a rate has one, at the beginning."""
    moments = []
    for topic in topics:
        rate = next((rate for end, rate in RATES.items() if topic.name.endswith(end)), 0)
        period = NANOSECONDS // rate if rate else 0
        moments += [(number * period, topic) for number in range(SECONDS * rate or 1)]
    data = {topic.name: default_message(topic.type) for topic in topics}
    for moment, topic in sorted(moments, key=lambda entry: entry[0]):
        yield topic.name, moment, data[topic.name]


def main() -> None:
    """Run until SIGTERM or the end of the work; exit codes as in `foundation.runtime.process`."""
    run("sample-bag", body, GRACE_SECONDS)


if __name__ == "__main__":
    main()
