"""A node is made when a link of its network runs: the middleware asks once, and one without hears nobody for ever."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.measuring import pods
from robotkube.robots.ros.adapters.network_links import (
    LINK_SECONDS_MAX,
    LOOPBACK,
    RUNNING,
    UP,
    awaited,
    links,
    wait_for_link,
)
from tests.stages.waiting import until

LO = UP | LOOPBACK | RUNNING


@pytest.mark.parametrize(
    ("flags", "names"),
    [
        ({}, []),
        ({"lo": LO}, []),
        ({"lo": LO, "eth0": UP}, ["eth0"]),
        ({"lo": LO, "eth0": UP | RUNNING}, []),
        ({"lo": LO, "eth0": UP, "wlan0": UP | RUNNING}, []),
        ({"lo": LO, "eth0": 0}, []),
    ],
    ids=str,
)
def test_what_is_waited_for(flags: dict[str, int], names: list[str]) -> None:
    assert awaited(flags) == names


def test_it_waits_until_a_link_runs_and_no_longer_than_it_may() -> None:
    now = 0.0

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    def at_three() -> dict[str, int]:
        return {"lo": LO, "eth0": UP | (RUNNING if now >= 3 else 0)}

    assert wait_for_link(at_three, lambda: now, sleep) == []
    assert 3 <= now < 4
    assert wait_for_link(lambda: {"eth0": UP}, lambda: now, sleep) == ["eth0"]
    assert now < 4 + LINK_SECONDS_MAX + 1


def test_this_machine_has_a_loopback() -> None:
    assert links()["lo"] & LOOPBACK


NODE = """
import sys, time
from robotkube.robots.ros.adapters.rclpy_node import RosNode
node = RosNode(sys.argv[1])
if sys.argv[1] == "sends":
    one = node.advertise("/x", "std_msgs/msg/String", "reliable", "volatile", 10)
else:
    one = node.subscribe("/x", "std_msgs/msg/String", "reliable", "volatile", 10)
print("made", flush=True)
while not one.matched:
    time.sleep(0.05)
print("matched", flush=True)
time.sleep(60)  # the other one shall find it, too
"""


@pytest.fixture
def nodes() -> Iterator[pods.Nodes]:
    made = pods.Nodes()
    yield made
    made.close()


@pytest.mark.processes
def test_a_node_hears_others_also_when_its_link_came_after_its_process(nodes: pods.Nodes, tmp_path: Path) -> None:
    place = nodes.node()
    late, other = nodes.pod(place), nodes.pod(place)
    host = f"{nodes.prefix}v0"
    subprocess.run(["ip", "link", "set", host, "down"], check=True, timeout=10)
    command = [sys.executable, "-c", NODE]
    (tmp_path / "sends").mkdir()
    (tmp_path / "hears").mkdir()
    logs = [tmp_path / name / "log" for name in ("sends", "hears")]
    started = [pods.start("late", [*command, "sends"], {}, logs[0], late)]
    try:
        time.sleep(2.0)  # longer than the process takes to its node, at most: it must not be made before the link runs
        assert "made" not in logs[0].read_text()
        subprocess.run(["ip", "link", "set", host, "up"], check=True, timeout=10)
        started.append(pods.start("other", [*command, "hears"], {}, logs[1], other))
        until(lambda: all("matched" in log.read_text() for log in logs))
    finally:
        for pod in started:
            pod.process.kill()
            pod.process.wait(5)
