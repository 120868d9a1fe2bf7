"""A detector that is killed while the broker is away: the next one tells what the first one had to tell."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measuring import pods
from robotkube.foundation.documents.core.yaml_codec import write_mapping
from tests.stages.detector.event_peer import EventPeer, broker_for_events
from tests.stages.detector.process import PUBLISHER, is_up
from tests.stages.detector.proximity_settings import SETTINGS
from tests.stages.programs import free_port
from tests.stages.ros.ros_domains import domain as ros_domain

pytestmark = pytest.mark.processes

WAIT_SECONDS = 30.0
NEAR = {**SETTINGS, "reactions": [{"rule": "near", "kind": "mqtt", "topic": "events/near"}]}


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + WAIT_SECONDS
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.01)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    with broker_for_events(tmp_path / "broker") as broker:
        yield broker


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    processes: list[subprocess.Popen[bytes]] = []

    def start(*arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        variables = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "ROS_DOMAIN_ID": ros_domain(),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(tmp_path / "ros"),
            **environment,
        }
        processes.append(subprocess.Popen([sys.executable, *arguments], env=variables, stdout=subprocess.DEVNULL))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait(WAIT_SECONDS)


def test_what_a_killed_detector_owed_the_broker_is_published_once(
    broker: pods.Broker, start: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    (tmp_path / "config.yaml").write_text(write_mapping(NEAR))
    port = free_port()
    secrets = broker.secret("cloud-0", "127.0.0.1")
    broker.stop()

    def detector() -> subprocess.Popen[bytes]:
        return start(
            "-m", "robotkube.robots.detector",
            ROBOTKUBE_CONFIG=str(tmp_path / "config.yaml"),
            ROBOTKUBE_SECRETS=str(secrets),
            ROBOTKUBE_HEALTH_PORT=str(port),
            ROBOTKUBE_REACTIONS=str(tmp_path / "reactions"),
        )  # fmt: skip

    def page(name: str) -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/{name}", timeout=5) as answer:
            return json.load(answer)

    def raised() -> list[str]:
        try:
            return [f"{event['id']}-{event['edge']}" for event in page("events")["events"]]
        except OSError:
            return []

    first = detector()
    publisher = start(*PUBLISHER, str(tmp_path), "60")
    until(lambda: len(raised()) >= 2)
    publisher.send_signal(signal.SIGSTOP)
    until(lambda: page("status")["reactions_journal"]["kept"] == len(raised()))
    owed = raised()
    first.kill()
    first.wait(WAIT_SECONDS)

    broker.start()
    listener = EventPeer(broker)
    listener.until(lambda: listener.connections)
    listener.turn()
    detector()
    listener.until(lambda: len(listener.heard) >= len(owed))
    listener.until(lambda: is_up(port) and page("status")["reactions_journal"]["kept"] == 0)
    published = [event["id"] for event in listener.heard]
    assert published[: len(owed)] == owed
    assert len(set(published)) == len(published), "what was raised between the look and the kill is there once, too"
    listener.channel.close()
