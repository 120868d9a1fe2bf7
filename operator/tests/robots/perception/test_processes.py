"""object-detection and object-tracking as processes on real ROS topics: a cloud in, an object with an identity out."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measuring import pods
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.testing.api_server import ApiServerInMemory
from scenarios.generator import scene
from tests.stages.ros import lidar_clouds
from tests.stages.ros.ros_domains import domain as ros_domain
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

SENDER = """
import sys, time
from pathlib import Path
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.bags.core.playback import restamped

node, data = RosNode("sender"), Path(sys.argv[1]).read_bytes()
clouds = node.advertise("/v/cloud", "sensor_msgs/msg/PointCloud2", depth=10)
tracks = node.subscribe("/v/tracks", "std_msgs/msg/String")
numbers = node.subscribe("/v/uncertainty", "std_msgs/msg/Float64")
for _ in range(600):
    clouds.publish(restamped(data, time.time_ns()))
    time.sleep(0.1)
    for message in tracks.take():
        print(message[8:].rstrip(b"\\0").decode(), flush=True)
    for message in numbers.take():
        print("uncertainty", len(message), flush=True)
"""
DETECTION = {
    "cloud": "/v/cloud",
    "objects": "/v/objects",
    "uncertainty": "/v/uncertainty",
    "method": "reflectance",
    "rangeMetres": 60,
    "pointsMin": 4,
}
# a pause of this machine between two clouds, however long, is no gap that ends a track
TRACKING = {"objects": "/v/objects", "tracks": "/v/tracks", "motion": "steady", "gateMetres": 4, "gapSeconds": 60}


class Stage:
    """Processes in a ROS domain of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []

    def run(self, name: str, *arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        variables = {
            **os.environ,
            "ROS_DOMAIN_ID": ros_domain(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.folder / "ros"),
            "PYTHONPATH": os.pathsep.join(sys.path),
            **environment,
        }
        with (self.folder / f"{name}.out").open("wb") as out, (self.folder / f"{name}.log").open("wb") as log:
            self.processes.append(subprocess.Popen([sys.executable, *arguments], env=variables, stdout=out, stderr=log))
        return self.processes[-1]

    def serve(self, name: str, settings: Mapping[str, Any], **environment: str) -> tuple[subprocess.Popen[bytes], int]:
        """One of the services, and its health port."""
        path = self.folder / f"{name}.yaml"
        port = pods.free_port()
        path.write_text(write_mapping(settings))
        process = self.run(
            name,
            "-m",
            f"robotkube.robots.perception.{name}",
            ROBOTKUBE_CONFIG=str(path),
            ROBOTKUBE_HEALTH_PORT=str(port),
            **environment,
        )
        return process, port

    def lines(self, name: str) -> list[str]:
        return (self.folder / f"{name}.out").read_text().splitlines()


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    made = Stage(tmp_path)
    yield made
    for process in made.processes:
        process.kill()
        process.wait(10)


def missing(port: int) -> str:
    """Empty when it is, else what is missing."""
    try:
        return page(port, "/readyz").removesuffix("ok\n")
    except urllib.error.HTTPError as error:
        with error:
            return error.read().decode()


def page(port: int, path: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=5) as answer:
        body: bytes = answer.read()
    return body.decode()


def test_a_vehicle_in_live_clouds_gets_an_identity(stage: Stage) -> None:
    other = scene.Place(20.0, 4.0, math.pi)
    (stage.folder / "cloud").write_bytes(lidar_clouds.cloud(other))
    services = [stage.serve("object_detection", DETECTION), stage.serve("object_tracking", TRACKING)]
    stage.run("sender", "-c", SENDER, str(stage.folder / "cloud"))

    def tracked() -> list[dict[str, Any]]:
        documents = (json.loads(line) for line in stage.lines("sender") if line.startswith("{"))
        return [document for document in documents if document["tracks"]]

    until(lambda: len(tracked()) >= 5 and "uncertainty 12" in stage.lines("sender"))
    assert {track["id"] for document in tracked() for track in document["tracks"]} == {1}
    [track] = tracked()[-1]["tracks"]
    assert math.dist((track["x"], track["y"]), lidar_clouds.seen_at(other)) < 0.5
    assert tracked()[-1]["frame"] == lidar_clouds.FRAME
    for (process, port), word in zip(services, ("detection", "tracking"), strict=True):
        assert page(port, "/readyz") == page(port, "/livez") == "ok\n"
        assert f"robotkube_{word}_malformed_messages_total 0" in page(port, "/metrics")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0  # its own bound makes it another number


@pytest.mark.parametrize(
    ("name", "settings", "problem"),
    [
        ("object_detection", {**DETECTION, "method": "guess"}, "method: 'guess' must match"),
        ("object_tracking", {**TRACKING, "gapSeconds": 0}, "gapSeconds: 0 must be a number from 0.01 to 60"),
    ],
)
def test_wrong_settings_are_refused_with_file_and_key(
    stage: Stage, name: str, settings: Mapping[str, Any], problem: str
) -> None:
    process, _ = stage.serve(name, settings)
    assert process.wait(20) == 2
    log = (stage.folder / f"{name}.log").read_text()
    assert f"{stage.folder}/{name}.yaml: {problem}" in log


def test_a_service_is_not_ready_while_it_refuses_its_newest_settings(stage: Stage) -> None:
    with ApiServerInMemory() as api:

        def change(**changes: Any) -> None:
            text = write_mapping({**TRACKING, **changes})
            api.put_config_map("vehicle-00", "object-tracking", {"config.yaml": text})

        change()
        place = {"ROBOTKUBE_CONFIGMAP": "vehicle-00/object-tracking", "ROBOTKUBE_API_SERVER": api.url}
        process, port = stage.serve("object_tracking", TRACKING, **place)
        until(lambda: "ready" in (stage.folder / "object_tracking.log").read_text())
        until(lambda: not missing(port))
        change(gapSeconds=0)
        until(lambda: "refused" in missing(port))
        assert "ones before are at work: config.yaml: gapSeconds: 0 must be a number" in missing(port)
        assert "robotkube_settings_refused 1" in page(port, "/metrics")
        change(gapSeconds=2)
        until(lambda: not missing(port))
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
