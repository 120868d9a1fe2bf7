"""Two bridges over a real broker that goes away, and settings that change: nothing is lost that need not be, nothing
comes twice, and what was given up is known by number and stamps. The ROS networks are in memory."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fakes import Endpoint, Network

from ci.benchmarks import pods
from ci.benchmarks.bags import message
from robotkube.adapters.mqtt_paho import BrokerAccount, PahoChannel
from robotkube.domain.bridging import GAPS_TOPIC, read_bridge_settings
from robotkube.domain.bridging_properties import read_gap_text
from robotkube.domain.messages import header_stamp, string_text
from robotkube.services.bridge import Bridge
from robotkube.services.bridge_flows import Sender
from robotkube.services.ownership import Ownership

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
CLOUD = {"name": "/vehicles/vehicle_00/cloud", "type": "sensor_msgs/msg/PointCloud2", "channel": "bulk"}
OTHER = {**POSE, "name": "/vehicles/vehicle_00/other"}
ANY_POSE = {**POSE, "name": "/vehicles/{agent}/pose"}
DRAIN_SECONDS_MAX = 30.0
POSE_SECONDS = 0.01


class Side:
    """A bridge with a ROS network in memory and connections to the broker."""

    def __init__(self, broker: pods.Broker, agent: str) -> None:
        self.broker, self.agent, self.network = broker, agent, Network()
        self.channels: dict[str, PahoChannel] = {}
        sender = Sender(7, time.time_ns, lambda name: "")
        self.bridge = Bridge(self.network, self._channel, sender, lambda *a, **k: None, Ownership())

    def configure(self, **settings: Any) -> None:
        self.bridge.configure(read_bridge_settings({"agent": self.agent, **settings}, "config.yaml"))

    def endpoint(self, topic: dict[str, str]) -> Endpoint:
        return self.network.endpoint(topic["name"])

    def _channel(self, agent: str, name: str, events: Any) -> PahoChannel:
        account = BrokerAccount("127.0.0.1", self.broker.port, agent, pods.password(agent))
        self.channels[name] = PahoChannel(lambda: account, f"{agent}-{name}", 60, events)
        return self.channels[name]


class Stage:
    """A vehicle and the cloud; `play` lets the vehicle's topics go at their rates."""

    def __init__(self, broker: pods.Broker) -> None:
        self.broker = broker
        self.vehicle, self.cloud = Side(broker, "vehicle-00"), Side(broker, "cloud-0")
        self.sent: dict[str, int] = {}

    def turn(self) -> None:
        for side in (self.vehicle, self.cloud):
            side.bridge.turn(time.monotonic())

    def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + DRAIN_SECONDS_MAX
        while not condition():
            assert time.monotonic() < deadline, f"did not happen: {self.vehicle.bridge.metrics()}"
            self.turn()
            time.sleep(POSE_SECONDS / 2)

    def ready(self) -> None:
        """Returns when both are connected and the vehicle's messages are heard."""
        self.until(lambda: self.vehicle.bridge.complaint is None and self.cloud.bridge.complaint is None)
        for _ in range(20):
            self.turn()
            time.sleep(POSE_SECONDS)

    def play(self, seconds: float, *topics: tuple[dict[str, str], float]) -> None:
        """Publish `topics` (with their hertz) in real time; message k has stamp k."""
        begin = time.monotonic()
        first = {topic["name"]: self.sent.get(topic["name"], 0) for topic, _ in topics}
        while (elapsed := time.monotonic() - begin) < seconds:
            for topic, hertz in topics:
                name = topic["name"]
                while self.sent.get(name, 0) < first[name] + elapsed * hertz:
                    number = self.sent.get(name, 0)
                    self.vehicle.endpoint(topic).waiting.append(message(number, number, 200))
                    self.sent[name] = number + 1
            self.turn()
            time.sleep(POSE_SECONDS / 2)

    def received(self, topic: dict[str, str]) -> list[int]:
        """Numbers of what reached the cloud's ROS network, in their order."""
        return [header_stamp(data) for data in self.cloud.endpoint(topic).published]

    def drained(self, topic: dict[str, str]) -> None:
        last = self.sent[topic["name"]] - 1
        self.until(lambda: last in self.received(topic)[-3:])

    def restart_broker(self, away: float, *topics: tuple[dict[str, str], float]) -> None:
        self.broker.stop(signal.SIGKILL)
        self.play(away, *topics)
        self.broker.start()


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    broker = pods.Broker(tmp_path, {"vehicle-00": pods.vehicle_rules("vehicle-00"), "cloud-0": pods.CLOUD_RULES})
    broker.start()
    made = Stage(broker)
    yield made
    for side in (made.vehicle, made.cloud):
        side.bridge.close()
    broker.stop()


@pytest.mark.parametrize(
    ("away", "hertz"), [(1.5, 100.0), pytest.param(20.0, 10.0, marks=pytest.mark.thorough)], ids=["short", "20 s"]
)
def test_an_outage_of_the_broker_costs_no_pose_and_every_missing_cloud_is_known(
    stage: Stage, away: float, hertz: float
) -> None:
    topics = ((POSE, 100.0), (CLOUD, hertz))
    stage.vehicle.configure(out=[POSE, CLOUD])
    stage.cloud.configure(**{"in": [POSE, CLOUD]}, publish_gaps=True)
    stage.ready()
    stage.play(1.0, *topics)
    stage.restart_broker(away, *topics)
    stage.play(8.0, *topics)
    for topic in (POSE, CLOUD):
        stage.drained(topic)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    clouds = stage.received(CLOUD)
    missing = sorted(set(range(stage.sent[CLOUD["name"]])) - set(clouds))
    assert clouds == sorted(set(clouds))
    assert len(missing) > away * hertz / 2
    told = [read_gap_text(string_text(one).decode()) for one in stage.cloud.network.endpoint(GAPS_TOPIC).published]
    assert sorted(number for gap in told for number in range(gap.first, gap.last + 1)) == missing
    assert sum(gap.count or 0 for gap in told) == len(missing)
    assert {(gap.topic, gap.where) for gap in told} == {(CLOUD["name"], "mqtt-bridge of vehicle-00")}


def test_a_connection_that_breaks_loses_and_doubles_nothing(stage: Stage) -> None:
    stage.vehicle.configure(out=[POSE])
    stage.cloud.configure(**{"in": [POSE]})
    stage.ready()
    for side in (stage.vehicle, stage.cloud, stage.vehicle):
        stage.play(0.5, (POSE, 400.0))
        side.channels["telemetry"].socket.shutdown(socket.SHUT_RDWR)
    stage.play(2.0, (POSE, 400.0))
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    assert 'connections_total{channel="telemetry"} 3' in stage.vehicle.bridge.metrics()


def test_a_topic_that_stays_loses_nothing_when_settings_change(stage: Stage) -> None:
    stage.vehicle.configure(out=[POSE])
    stage.cloud.configure(**{"in": [POSE]})
    stage.ready()
    stage.play(0.4, (POSE, 400.0))
    sink = stage.cloud.endpoint(POSE)
    for out, into in (
        ([POSE, CLOUD], [POSE, CLOUD]),
        ([POSE, OTHER], [POSE, ANY_POSE, OTHER]),
        ([POSE], [POSE, ANY_POSE]),
        ([POSE, CLOUD], [POSE]),
        ([POSE], [POSE]),
    ):
        stage.cloud.configure(**{"in": into})
        stage.vehicle.configure(out=out)
        stage.play(0.4, (POSE, 400.0))
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    assert stage.cloud.endpoint(POSE) is sink


def test_a_topic_of_any_agent_loses_nothing_from_its_first_message_on(stage: Stage) -> None:
    stage.vehicle.configure(out=[POSE])
    stage.cloud.configure(**{"in": [ANY_POSE]})
    stage.ready()
    stage.play(0.5, (POSE, 400.0))
    stage.drained(POSE)
    stage.restart_broker(0.5, (POSE, 400.0))
    stage.play(2.0, (POSE, 400.0))
    stage.drained(POSE)
    assert stage.received(POSE) == list(range(stage.sent[POSE["name"]]))
    assert not any("is not carried" in str(side.bridge.complaint) for side in (stage.vehicle, stage.cloud))
