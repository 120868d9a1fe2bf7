"""The bridge one would write first, as a baseline: an rclpy executor, and one MQTT message per ROS message.

Takes the settings and the Secret of our bridge and sends batches as it does, with one message in each, so that the
other end understands both.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import rclpy
import yaml
from paho.mqtt.enums import CallbackAPIVersion
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile

from robotkube.robots.mqtt.core.batches import decode_batch, encode_batch

CONNECT_SECONDS_MAX = 30


def connect(secrets: Path) -> mqtt.Client:
    """A connected client; says so in a line as our bridge does."""
    word = {key: (secrets / "broker" / key).read_text() for key in ("username", "password", "host", "port")}
    connected = threading.Event()
    client = mqtt.Client(CallbackAPIVersion.VERSION2, f"{word['username']}-telemetry", protocol=mqtt.MQTTv5)
    client.username_pw_set(word["username"], word["password"])
    client.on_connect = lambda *_: connected.set()
    client.connect(word["host"], int(word["port"]))
    client.loop_start()
    if not connected.wait(CONNECT_SECONDS_MAX):
        raise SystemExit("the broker does not answer")
    print('"connected"', flush=True)
    return client


def forward(client: mqtt.Client, topic: str, session: int) -> Callable[[bytes], None]:
    """What the executor calls for every message."""
    count = 0

    def publish(data: bytes) -> None:
        nonlocal count
        client.publish(f"mqtt{topic}", encode_batch(session, count, [data]), qos=1)
        count += 1

    return publish


def backward(client: mqtt.Client, node: Any, topics: list[dict[str, Any]]) -> None:
    """Publish in ROS what the broker sends, in the callback of paho's thread."""
    profile: Any = QoSProfile
    publishers = {
        f"mqtt{topic['name']}": node.create_publisher(kind(topic["type"]), topic["name"], profile(depth=topic["depth"]))
        for topic in topics
    }

    def received(_: mqtt.Client, __: object, message: mqtt.MQTTMessage) -> None:
        for data in decode_batch(message.payload).messages:
            publishers[message.topic].publish(bytes(data))

    client.on_message = received
    for name in publishers:
        client.subscribe(name, qos=1)


def kind(name: str) -> Any:
    """The Python class of geometry_msgs/msg/PoseStamped and the like."""
    package, _, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), message)


def main() -> None:
    """Runs until it is told to end."""
    settings = yaml.safe_load(Path(os.environ["ROBOTKUBE_CONFIG"]).read_text())
    client = connect(Path(os.environ["ROBOTKUBE_SECRETS"]))
    session = int.from_bytes(os.urandom(8), "little")
    rclpy.init()
    node = rclpy.create_node("naive_bridge")
    profile: Any = QoSProfile
    backward(client, node, settings.get("in", []))
    for topic in settings.get("out", []):
        act = forward(client, topic["name"], session)
        node.create_subscription(kind(topic["type"]), topic["name"], act, profile(depth=topic["depth"]), raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    try:
        executor.spin()
    except ExternalShutdownException:
        sys.exit(0)


if __name__ == "__main__":
    main()
