"""A peer of a detector at a real broker: it listens to the events and may publish; and that broker."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from benchmarks.measuring import pods
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel

PEER, DETECTOR = "vehicle-07", "cloud-0"
WAIT_SECONDS = 30.0


@contextmanager
def broker_for_events(folder: Path) -> Iterator[pods.Broker]:
    """A broker on which peer and detector may do anything."""
    broker = pods.Broker(folder, {name: ["topic readwrite #"] for name in (PEER, DETECTOR)})
    broker.start()
    try:
        yield broker
    finally:
        broker.stop()


class EventPeer:
    """Who hears events at the broker. `heard`: the events in their order; `connections`: how often the broker took it
    in."""

    def __init__(self, broker: pods.Broker) -> None:
        account = BrokerAccount("127.0.0.1", broker.port, PEER, pods.password(PEER))
        self.connections = 0
        self.heard = list[dict[str, Any]]()
        self._answers: dict[int, bool] = {}
        self.channel = PahoChannel(lambda: account, f"{PEER}-telemetry", 60, self)

    def connected(self, session_kept: bool) -> None:
        self.connections += 1
        self.channel.subscribe(["events/#"])

    def disconnected(self) -> None: ...

    def acknowledged(self, token: int, heard: bool) -> None:
        self._answers[token] = heard

    def rejected(self, token: int, reason: str) -> None:
        pytest.fail(reason)

    def refused(self, topic: str, reason: str) -> None:
        pytest.fail(reason)

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.heard.append(json.loads(payload))

    def turn(self) -> None:
        """Sends what waits and hears what came."""
        self.channel.turn(time.monotonic())
        self.channel.flush()

    def say(self, topic: str, payload: bytes, properties: bytes) -> None:
        """Publishes until the broker has somebody for it: who is connected may not have subscribed yet."""
        heard = False
        while not heard:
            self._answers.clear()
            token = self.channel.publish(topic, payload, False, properties)
            assert token is not None
            self.until(lambda token=token: token in self._answers)
            heard = self._answers[token]

    def until(self, condition: Callable[[], object]) -> None:
        """Takes part until the condition holds; fails after `WAIT_SECONDS`."""
        deadline = time.monotonic() + WAIT_SECONDS
        while not condition():
            assert time.monotonic() < deadline, "did not happen in time"
            self.turn()
            time.sleep(0.01)
