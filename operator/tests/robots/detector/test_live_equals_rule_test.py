"""A bag played live (player -> ROS -> detector's process) raises the events that `robotkube rule test` says."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from robotkube.cli import main as cli
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from robotkube.robots.bags.adapters.writing import BagWriter
from robotkube.robots.bags.core.playback import BagTopic
from tests.stages.programs import free_port
from tests.stages.ros.ros_domains import domain as ros_domain
from tests.stages.waiting import until

pytestmark = pytest.mark.processes

POSE = "geometry_msgs/msg/PoseStamped"
AGENTS = ("vehicle-00", "vehicle-01")
SECONDS, HERTZ = 4, 40
LEAD_SECONDS, LIVE_SECONDS_MAX = 1, 60.0
SETTINGS = {
    "name": "cloud-0/live",
    "topics": [{"name": "/vehicles/{agent}/pose", "type": POSE}],
    "rules": [
        {"name": "near", "kind": "proximity", "topic": "/vehicles/{agent}/pose", "start_distance_m": 50,
         "stop_distance_m": 60},
        {"name": "beyond", "kind": "threshold", "topic": "/vehicles/{agent}/pose", "field": "pose.position.x",
         "start_above": 40, "stop_below": 30},
        {"name": "within", "kind": "geofence", "topic": "/vehicles/{agent}/pose",
         "area": {"type": "Polygon", "coordinates": [[[-20, -9], [20, -9], [20, 9], [-20, 9], [-20, -9]]]}},
        {"name": "met", "kind": "combination", "all": ["within", "near"], "scope": "group",
         "agents": list(AGENTS)},
    ],
}  # fmt: skip
PLAY = """
import sys, time
from pathlib import Path
from robotkube.robots.bags.adapters.reading import open_bag
from robotkube.robots.bags.adapters.ledger_files import LedgerFiles
from robotkube.robots.ros.adapters.rclpy_node import RosNode
from robotkube.robots.bags.core.playback import PlaybackRun
from robotkube.robots.bags.__main__ import WallClock
from robotkube.robots.bags.loops.player import Player
folder, lead = Path(sys.argv[1]), int(sys.argv[2])
player = Player(RosNode("player"), open_bag(folder), LedgerFiles(folder / "ledger"), WallClock(),
                lambda *a, **k: None, lambda: False)
while not all(player.matched.values()):
    time.sleep(0.01)
start = (int(time.time()) + 1 + lead) * 1_000_000_000
folder.with_name("start.part").write_text(str(start))
folder.with_name("start.part").rename(folder.with_name("start"))
player.order(PlaybackRun("run", start))
player.serve()
"""


def pose(stamp: int, x: float, y: float) -> bytes:
    """A serialised PoseStamped of frame map."""
    head = struct.pack("<iII4s", *divmod(stamp, 1_000_000_000), 4, b"map\0")
    return b"\0\1\0\0" + head + struct.pack("<7d", x, y, 0, 0, 0, 0, 1)


def write(folder: Path) -> None:
    """Two that meet and part on two lanes."""
    topics = [
        BagTopic(f"/vehicles/{a.replace('-', '_')}/pose", POSE, "reliable", "volatile", SECONDS * HERTZ) for a in AGENTS
    ]
    with BagWriter(folder, topics) as writer:
        for step in range(SECONDS * HERTZ):
            offset = step * 1_000_000_000 // HERTZ
            for topic, way in zip(topics, (1, -1), strict=True):
                writer.add(topic.name, offset, pose(offset, way * (step - SECONDS * HERTZ / 2) * 0.9, -4.0 * way))
        writer.finish()


@pytest.fixture
def spawn(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    processes: list[subprocess.Popen[bytes]] = []

    def spawn(*words: str, **variables: str) -> subprocess.Popen[bytes]:
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": ros_domain(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(tmp_path / "ros"),
            "PYTHONPATH": os.pathsep.join(sys.path),
            **variables,
        }
        with (tmp_path / f"log-{len(processes)}").open("wb") as log:
            processes.append(subprocess.Popen([sys.executable, *words], env=environment, stdout=log, stderr=log))
        return processes[-1]

    yield spawn
    for process in processes:
        process.kill()
        process.wait(10)


def page(port: int, path: str) -> Any:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=5) as answer:
            return json.loads(answer.read())
    except (urllib.error.URLError, OSError):
        return {}


def edges(document: Any) -> set[tuple[str, str, str, tuple[str, ...], int]]:
    return {
        (edge["id"], edge["edge"], edge["rule"], tuple(edge["agents"]), edge["stamp"])
        for edge in document.get("events", ())
    }


def test_live_equals_rule_test(
    spawn: Callable[..., subprocess.Popen[bytes]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "bag")
    settings = tmp_path / "config.yaml"
    settings.write_text(write_mapping(SETTINGS))
    port = free_port()
    spawn("-m", "robotkube.robots.detector", ROBOTKUBE_CONFIG=str(settings), ROBOTKUBE_HEALTH_PORT=str(port))
    until(lambda: "events" in page(port, "/events"), "the detector answers")
    spawn("-c", PLAY, str(tmp_path / "bag"), str(LEAD_SECONDS))  # begins when the detector listens
    until((tmp_path / "start").exists, "the player begins")
    start = int((tmp_path / "start").read_text())
    capsys.readouterr()
    assert cli.main(["rule", "test", str(settings), str(tmp_path / "bag"), "--start", str(start), "-o", "json"]) == 0
    expected = edges(json.loads(capsys.readouterr().out))
    assert {rule for _, _, rule, _, _ in expected} == {"near", "beyond", "within", "met"}
    ledger = tmp_path / "bag" / "ledger" / "run"
    until(lambda: any('"end"' in file.read_text() for file in ledger.glob("*.jsonl")), "the bag ends", LIVE_SECONDS_MAX)
    topics = page(port, "/input")["topics"]
    until(
        lambda: sum(t["received"] for t in page(port, "/input")["topics"].values()) == 2 * SECONDS * HERTZ,
        f"every pose arrives, there were {topics}",
    )
    until(lambda: len(edges(page(port, "/events"))) >= len(expected), "as many events")
    assert edges(page(port, "/events")) == expected
    met = next(edge for edge in page(port, "/events")["events"] if edge["rule"] == "near")
    address = f"http://127.0.0.1:{port}"
    assert cli.main(["rule", "explain", met["id"], "--source", address, "-o", "json"]) == 0
    explained = json.loads(capsys.readouterr().out)
    assert {cause["topic"] for edge in explained["edges"] for cause in edge["causes"]} == {
        f"/vehicles/{agent.replace('-', '_')}/pose" for agent in AGENTS
    }
    assert cli.main(["rule", "explain", met["id"], "--source", "http://127.0.0.1:9"]) == 3
    assert "is that the address of a running detector?" in capsys.readouterr().err
