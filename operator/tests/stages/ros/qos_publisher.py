"""Publishes one number on a real topic every 50 ms (or `period` seconds), with any quality of service, until its end or
the last of `count`, which stays there for those who come later; of so many the second waits for somebody to listen.

    python -m tests.stages.ros.qos_publisher TOPIC '{"reliability": "reliable", "deadline": 0.5, ...}'

The first message, -1, is said before anybody can be connected.
"""

from __future__ import annotations

import json
import os
import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64


def main(topic: str, wanted: dict[str, str | float]) -> None:
    rclpy.init()
    node = rclpy.create_node(f"publisher_{os.getpid()}")
    profile = QoSProfile(
        depth=1000,
        reliability=ReliabilityPolicy[str(wanted.get("reliability", "reliable")).upper()],
        durability=DurabilityPolicy[str(wanted.get("durability", "volatile")).upper()],
    )
    if "deadline" in wanted:
        profile.deadline = Duration(seconds=float(wanted["deadline"]))
    if "lease" in wanted:
        profile.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC
        profile.liveliness_lease_duration = Duration(seconds=float(wanted["lease"]))
    publisher = node.create_publisher(Float64, topic, profile)
    number = -1.0
    count = float(wanted.get("count", "inf"))
    heard = count == float("inf")
    while True:
        heard = heard or publisher.get_subscription_count() > 0
        if number < 0 or (heard and number + 1 < count):
            publisher.publish(Float64(data=number))
            number += 1
        time.sleep(float(wanted.get("period", 0.05)))


if __name__ == "__main__":
    main(sys.argv[1], json.loads(sys.argv[2]))
