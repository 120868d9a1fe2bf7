"""Poses from the broker: what comes is shown twice a second, what cannot be read ends nothing, a broker that is away is
said."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.measuring import pods
from robotkube.delivery.console.adapters.broker_poses import SOURCE, BrokerPoses
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.loops.model import ReadModel
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.core.batches import encode_batch
from tests.delivery.console.test_poses import TOPIC, pose, sampler
from tests.stages.delivery.tasks.mqtt_connection import Connection
from tests.stages.waiting import until


def now_ms() -> int:
    return time.time_ns() // 1_000_000


@pytest.fixture
def model() -> ReadModel:
    return ReadModel("e", now_ms)


def account(port: int, name: str = "observer") -> BrokerAccount:
    return BrokerAccount("127.0.0.1", port, name, pods.password(name))


def test_what_cannot_be_read_is_counted_and_ends_nothing(model: ReadModel) -> None:
    poses = BrokerPoses(lambda: account(1), sampler(), model, lambda: 1000)
    for payload in (b"", b"RKF1", encode_batch(1, 0, [b"x"]), encode_batch(1, 0, [])):
        poses.received(TOPIC, payload, b"")
    poses.received(TOPIC, encode_batch(1, 1, [pose()]), b"")
    assert list(model.documents(kinds.POSES)) == ["vehicle-00"]
    counts = {series.name: series.values[()] for series in poses.metrics()}
    assert counts["robotkube_console_pose_messages_total"] == 5
    assert counts["robotkube_console_pose_messages_unreadable_total"] == 3
    assert counts["robotkube_console_poses_total"] == 1


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    rules = {"vehicle-00": pods.vehicle_rules("vehicle-00"), "observer": ["topic read mqtt/#"]}
    running = pods.Broker(tmp_path, rules)
    running.start()
    yield running
    running.stop()


@pytest.mark.processes
def test_poses_come_and_a_broker_that_is_away_is_said(broker: pods.Broker, model: ReadModel) -> None:
    poses = BrokerPoses(lambda: account(broker.port), sampler(), model, now_ms)
    stopping = threading.Event()
    running = threading.Thread(target=poses.run, args=(stopping,))
    running.start()
    try:
        until(lambda: model.documents(kinds.SOURCES).get(SOURCE, {}).get("ok"), "it is connected")
        assert position(broker, model, 1.0) == 1.0
        broker.stop()
        until(lambda: not model.documents(kinds.SOURCES)[SOURCE]["ok"], "it is said that the broker is away")
        assert model.documents(kinds.SOURCES)[SOURCE]["advice"]
        assert list(model.documents(kinds.POSES)) == ["vehicle-00"], "the last pose stands"
        broker.start()
        until(lambda: model.documents(kinds.SOURCES)[SOURCE]["ok"], "it is connected again")
        assert position(broker, model, 2.0) == 2.0
    finally:
        stopping.set()
        running.join(10)


def position(broker: pods.Broker, model: ReadModel, x: float) -> float:
    """The place at which the vehicle is shown after it said `x`, again and again until that is seen: the first may be
    too early."""
    sender = Connection(broker.port, "vehicle-00", pods.password("vehicle-00"))

    def seen() -> bool:
        sender.publish(TOPIC, encode_batch(1, 0, [pose(x=x)]))
        return bool(model.documents(kinds.POSES).get("vehicle-00", {}).get("x") == x)

    until(seen, "the pose is shown")
    sender.close()
    return float(model.documents(kinds.POSES)["vehicle-00"]["x"])
