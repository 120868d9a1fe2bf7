"""The detector's process without ROS: topics from a real broker, also of a type that is not installed, events to it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measuring import pods
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.robots.mqtt.core.batches import encode_batch
from robotkube.robots.mqtt.core.message_properties import type_properties, types_topic
from tests.stages.detector.event_peer import EventPeer, broker_for_events
from tests.stages.detector.rules import number
from tests.stages.programs import free_port
from tests.stages.ros.ros_domains import domain as ros_domain

pytestmark = pytest.mark.processes

WAIT_SECONDS = 30.0
LEVELS, TYPE = "/vehicles/{agent}/level", "odd_msgs/msg/Level"
TOPIC = "mqtt/vehicles/vehicle_07/level"
SETTINGS: dict[str, Any] = {
    "name": "cloud-0/watch",
    "topics": [{"name": LEVELS, "type": TYPE, "source": "mqtt"}],
    "rules": [
        {"name": "low", "kind": "threshold", "topic": LEVELS, "field": "left", "start_below": 5, "stop_above": 6}
    ],
    "reactions": [{"rule": "low", "kind": "mqtt", "topic": "events/low"}],
}


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    with broker_for_events(tmp_path / "broker") as broker:
        yield broker


def test_a_type_that_is_not_installed_comes_with_its_definition(broker: pods.Broker, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(write_mapping(SETTINGS))
    port = free_port()
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        "ROS_DOMAIN_ID": ros_domain(),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml"),
        "ROBOTKUBE_SECRETS": str(broker.secret("cloud-0", "127.0.0.1")),
        "ROBOTKUBE_HEALTH_PORT": str(port),
    }
    command = [sys.executable, "-m", "robotkube.robots.detector"]
    detector = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    peer = EventPeer(broker)
    frames = iter(range(1000))

    def say(value: float) -> None:
        peer.say(TOPIC, encode_batch(1, next(frames), [number(value)]), type_properties(TYPE, ""))

    def status() -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/status", timeout=5) as answer:
            return json.load(answer)

    def ready() -> bool:
        try:
            return status()["not_ready"] == ""
        except OSError:
            return False

    try:
        peer.until(lambda: peer.connections)
        peer.until(ready)
        definition = type_properties(TYPE, "", "text/plain")
        peer.channel.publish(types_topic(TOPIC), b"float64 left\n", True, definition)
        say(9.0)
        peer.until(lambda: "/vehicles/vehicle_07/level" in status()["topics"])
        say(4.0)
        peer.until(lambda: len(peer.heard) == 1)
        broker.stop()
        peer.until(lambda: "broker" in status()["not_ready"])
        broker.start()
        peer.until(lambda: peer.connections == 2 and ready())
        say(7.0)
        peer.until(lambda: len(peer.heard) == 2)
        # the broker may tell the listener before it acknowledges to the detector
        peer.until(lambda: status()["reactions"]["mqtt low events/low"]["delivered"] == 2)
        shown = status()
        detector.send_signal(signal.SIGTERM)
        assert detector.wait(9.0) == 0
    finally:
        detector.kill()
        detector.communicate(timeout=WAIT_SECONDS)
        peer.channel.close()
    assert [(notification["edge"], notification["agents"]) for notification in peer.heard] == [
        ("start", ["vehicle-07"]),
        ("stop", ["vehicle-07"]),
    ]
    assert peer.heard[0]["causes"][0]["values"] == {"left": 4.0}
    assert shown["topics"]["/vehicles/vehicle_07/level"]["received"] == 3
