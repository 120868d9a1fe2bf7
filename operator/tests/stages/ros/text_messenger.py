"""Says a text on one topic until it is heard on another; ends with 0 then, after SECONDS_MAX with 1.

python3 operator/tests/stages/ros/text_messenger.py TOPIC_SAID TOPIC_HEARD TEXT
"""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

SECONDS_MAX = 30.0
TURN_SECONDS = 0.1
QOS = QoSProfile(depth=10)


def main(said: str, heard: str, text: str) -> int:
    rclpy.init()
    node = rclpy.create_node("messenger")
    texts: list[str] = []

    def hear(message: Any) -> None:
        texts.append(message.data)

    node.create_subscription(String, heard, hear, QOS)
    publisher = node.create_publisher(String, said, QOS)
    end = time.monotonic() + SECONDS_MAX
    while text not in texts and time.monotonic() < end:
        publisher.publish(String(data=text))
        rclpy.spin_once(node, timeout_sec=TURN_SECONDS)
    print(f"heard: {sorted(set(texts))}")
    rclpy.try_shutdown()
    return 0 if text in texts else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
