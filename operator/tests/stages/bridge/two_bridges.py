"""Two bridges over a real broker; their ROS networks are in memory."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.measuring import pods
from benchmarks.measuring.bags import message
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.bridge.core.settings import read_bridge_settings
from robotkube.robots.bridge.loops.bridge import Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.ros.core.common_messages import header_stamp
from tests.stages.bridge.memory_network import Endpoint, Network

DRAIN_SECONDS_MAX = 30.0
POSE_SECONDS = 0.01


class Side:
    """A bridge with a ROS network in memory and connections to the broker."""

    def __init__(self, broker: pods.Broker, agent: str, port: int = 0) -> None:
        self.broker = broker
        self.agent = agent
        self.network = Network()
        self.port = port or broker.port
        self.channels: dict[str, PahoChannel] = {}
        sender = SendingSession(7, time.time_ns, lambda name: f"definition of {name}")
        self.bridge = Bridge(self.network, self._channel, sender, lambda *a, **k: None, Fencing())

    def configure(self, **settings: Any) -> None:
        self.bridge.configure(read_bridge_settings({"agent": self.agent, **settings}, "config.yaml"))

    def endpoint(self, topic: dict[str, str]) -> Endpoint:
        return self.network.endpoint(topic["name"])

    def _channel(self, agent: str, name: str, events: Any) -> PahoChannel:
        account = BrokerAccount("127.0.0.1", self.port, agent, pods.password(agent))
        bounded = name != "safety"
        self.channels[name] = PahoChannel(lambda: account, f"{agent}-{name}", 60, events, bounded=bounded)
        return self.channels[name]


class Stage:
    """A vehicle and the cloud; `play` lets the vehicle's topics go at their rates. `port`: the vehicle's way to the
    broker, where it is another one."""

    def __init__(self, broker: pods.Broker, port: int = 0) -> None:
        self.broker = broker
        self.vehicle, self.cloud = Side(broker, "vehicle-00", port), Side(broker, "cloud-0")
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
        """Returns when both are connected and the broker has what the cloud asks for."""
        self.until(lambda: self.vehicle.bridge.complaint is None and self.cloud.bridge.complaint is None)
        self.until(lambda: not any(channel._subscribing for channel in self.cloud.channels.values()))

    def connection_of(self, side: Side) -> socket.socket:
        """The connection of a side's telemetry, once the broker has taken it."""
        channel = side.channels["telemetry"]
        self.until(lambda: channel.complaint is None)
        connection: socket.socket = channel.socket
        return connection

    def play(self, seconds: float, *topics: tuple[dict[str, str], float], singly: bool = False) -> None:
        """Publish `topics` (with their hertz) in real time; message k has stamp k. `singly`: a batch for each, also
        when this machine has come to a halt for a moment."""
        begin = time.monotonic()
        first = {topic["name"]: self.sent.get(topic["name"], 0) for topic, _ in topics}
        while (elapsed := time.monotonic() - begin) < seconds:
            for topic, hertz in topics:
                name = topic["name"]
                while self.sent.get(name, 0) < first[name] + elapsed * hertz:
                    number = self.sent.get(name, 0)
                    self.vehicle.endpoint(topic).waiting.append(message(number, number, 200))
                    self.sent[name] = number + 1
                    if singly:
                        self.turn()
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
        self.play(away, *topics, singly=True)
        self.broker.start()


@contextmanager
def running(tmp_path: Path, way: Callable[[int], int] = int) -> Iterator[Stage]:
    """A stage with a broker that runs; `way`: the port of the vehicle's way to the broker's port."""
    broker = pods.Broker(tmp_path, {"vehicle-00": pods.vehicle_rules("vehicle-00"), "cloud-0": pods.CLOUD_RULES})
    broker.start()
    made = Stage(broker, way(broker.port))
    try:
        yield made
    finally:
        for side in (made.vehicle, made.cloud):
            side.bridge.close()
        broker.stop()
