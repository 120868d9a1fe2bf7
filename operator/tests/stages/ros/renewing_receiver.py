"""Receives numbers on a real topic while its subscription is made anew again and again; writes them in their order.

    python -m tests.stages.ros.renewing_receiver TOPIC FILE

The first subscription asks for nothing that was said before, all others do. It ends when it has COUNT of them: as many
as publisher and subscriptions keep, so that the slowest of them misses nothing.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import time
from pathlib import Path

from robotkube.robots.detector.adapters import ros_topics
from robotkube.robots.detector.adapters.ros_topics import RosTopics
from robotkube.robots.detector.core.settings import TopicSettings
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.ros.core.qos import TRANSIENT_LOCAL, QosProfile
from robotkube.robots.ros.core.topic_patterns import TopicPattern

COUNT, MESSAGES_BETWEEN = 1000, 100
SECONDS_MAX = 25.0


def main(name: str, file: Path) -> None:
    ros_topics.KNOWN_SECONDS = 600.0  # the first renewal comes early enough, however slow the machine
    topics = RosTopics(RosNode("receiver"))
    settings = TopicSettings(TopicPattern(name), "std_msgs/msg/Float64", depth=COUNT)
    subscription = topics.subscribe(name, settings, QosProfile())
    numbers = list[float]()
    renewals = 0
    end = time.monotonic() + SECONDS_MAX
    while len(numbers) < COUNT and time.monotonic() < end:
        time.sleep(0.015)
        numbers += [struct.unpack_from("<d", data, 4)[0] for data, _ in subscription.drain(1000)]
        if len(numbers) >= (renewals + 1) * MESSAGES_BETWEEN:
            renewals += 1
            subscription = topics.subscribe(name, settings, QosProfile(durability=TRANSIENT_LOCAL), subscription)
    file.write_text(json.dumps(numbers))
    os._exit(0 if len(numbers) >= COUNT else 1)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
