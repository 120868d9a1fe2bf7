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
from programs import free_port
from proximity import SETTINGS

from ci.benchmarks import pods
from robotkube.adapters.mqtt_paho import BrokerAccount, PahoChannel
from robotkube.domain.texts import write_mapping

WAIT_SECONDS = 30.0
PUBLISHER = Path(__file__).parents[1] / "publisher.py"
NEAR = {**SETTINGS, "reactions": [{"rule": "near", "kind": "mqtt", "topic": "events/near"}]}


class Listener:
    """Hears events."""

    def __init__(self, broker: pods.Broker) -> None:
        account = BrokerAccount("127.0.0.1", broker.port, "vehicle-07", pods.password("vehicle-07"))
        self.connections, self.heard = 0, list[dict[str, Any]]()
        self.channel = PahoChannel(lambda: account, "vehicle-07-telemetry", 60, self)

    def connected(self, session_kept: bool) -> None:
        self.connections += 1
        self.channel.subscribe(["events/#"])

    def disconnected(self) -> None: ...

    def acknowledged(self, token: int, heard: bool) -> None: ...

    def rejected(self, token: int, reason: str) -> None:
        pytest.fail(reason)

    def refused(self, topic: str, reason: str) -> None:
        pytest.fail(reason)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.heard.append(json.loads(payload))

    def turn(self) -> None:
        self.channel.turn(time.monotonic())
        self.channel.flush()


def until(condition: Callable[[], object], meanwhile: Callable[[], None] = lambda: None) -> None:
    deadline = time.monotonic() + WAIT_SECONDS
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        meanwhile()
        time.sleep(0.01)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    accounts = {name: ["topic readwrite #"] for name in ("vehicle-07", "cloud-0")}
    broker = pods.Broker(tmp_path / "broker", accounts)
    broker.start()
    yield broker
    broker.stop()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    processes: list[subprocess.Popen[bytes]] = []

    def start(*arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        variables = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(sys.path),
            "ROS_DOMAIN_ID": str(100 + os.getpid() % 100),
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
    port, secrets = free_port(), broker.secret("cloud-0", "127.0.0.1")
    broker.stop()

    def detector() -> subprocess.Popen[bytes]:
        return start(
            "-m", "robotkube.entrypoints.detector",
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

    first, publisher = detector(), start(str(PUBLISHER), str(tmp_path), "60")
    until(lambda: len(raised()) >= 2)
    publisher.send_signal(signal.SIGSTOP)
    until(lambda: page("status")["reactions_journal"]["kept"] == len(raised()))
    owed = raised()
    first.kill()
    first.wait(WAIT_SECONDS)

    broker.start()
    listener = Listener(broker)
    until(lambda: listener.connections, listener.turn)
    listener.turn()
    detector()
    until(lambda: len(listener.heard) >= len(owed), listener.turn)
    assert [event["id"] for event in listener.heard] == owed
    until(lambda: page("status")["reactions_journal"]["kept"] == 0, listener.turn)
    assert [event["id"] for event in listener.heard] == owed
    listener.channel.close()
