"""A bridge over a real mosquitto whose node was cut off from broker and API server, and is back after a take-over or
before one."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.measuring import pods
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, ConfigMapWatch
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.bridge.core.settings import read_bridge_settings
from robotkube.robots.bridge.loops.bridge import Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.mqtt.core.batches import decode_batch
from robotkube.robots.mqtt.ports import ChannelEvents
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.bridge.memory_network import Network

pytestmark = pytest.mark.processes

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
SETTINGS = {"config.yaml": "agent: vehicle-00", "movable": "true"}
WAIT_SECONDS_MAX = 30.0
CUT_SECONDS = 90.0
TURNS_AFTER = 40


class Receiver:
    """Who hears the topic, in whatever order its batches come."""

    def __init__(self, account: BrokerAccount) -> None:
        self.messages: list[bytes] = []
        self.channel = PahoChannel(lambda: account, "cloud-0-telemetry", 60, self)

    def connected(self, session_kept: bool) -> None:
        self.channel.subscribe([f"mqtt{POSE['name']}"])

    def disconnected(self) -> None: ...

    def acknowledged(self, token: int, heard: bool) -> None: ...

    def refused(self, topic: str, reason: str) -> None: ...

    def granted(self, topic: str) -> None: ...

    def rejected(self, token: int, reason: str) -> None: ...

    def received(self, topic: str, payload: bytes, properties: bytes) -> None:
        self.messages += decode_batch(payload).messages


class Stage:
    """Bridge and receiver at one broker; the clock of the settings goes on by leaps."""

    def __init__(self, broker: pods.Broker, api: ApiServerInMemory) -> None:
        self.leap = 0.0
        self.network = Network()
        self.ownership = Fencing("edge-0", True, self.clock)
        self.watch = ConfigMapWatch(ApiServer(api.url), "a", "bridge", self.told, clock=self.clock)
        self.ownership.watch(self.watch)
        self.watch.start()
        sender, receiver = (
            BrokerAccount("127.0.0.1", broker.port, name, pods.password(name)) for name in ("vehicle-00", "cloud-0")
        )

        def channel(agent: str, name: str, events: ChannelEvents) -> PahoChannel:
            self.channel = PahoChannel(lambda: sender, f"{agent}-{name}", 60, events)
            return self.channel

        sending = SendingSession(42, time.time_ns, lambda name: "")
        self.bridge = Bridge(self.network, channel, sending, lambda event, **fields: None, self.ownership)
        self.bridge.configure(read_bridge_settings({"agent": "vehicle-00", "out": [POSE]}, "config.yaml"))
        self.receiver = Receiver(receiver)

    def clock(self) -> float:
        return time.monotonic() + self.leap

    def told(self, settings: object) -> None:
        self.ownership.observe(settings)  # type: ignore[arg-type]

    def publish(self, *messages: bytes) -> None:
        self.network.endpoint(POSE["name"]).waiting += messages

    def turn(self, bridging: bool = True) -> None:
        if bridging:
            self.bridge.hold(self.ownership.fenced)
            self.bridge.turn(time.monotonic())
        self.receiver.channel.turn(time.monotonic())
        self.receiver.channel.flush()
        time.sleep(0.01)

    def until(self, condition: Callable[[], object], bridging: bool = True) -> None:
        deadline = time.monotonic() + WAIT_SECONDS_MAX
        while not condition():
            assert time.monotonic() < deadline, "did not happen in time"
            self.turn(bridging)


@pytest.mark.parametrize("taken_over", [True, False])
def test_what_waited_over_a_cut_is_sent_by_one_of_both(tmp_path: Path, taken_over: bool) -> None:
    broker = pods.Broker(tmp_path, {"vehicle-00": pods.vehicle_rules("vehicle-00"), "cloud-0": pods.CLOUD_RULES})
    broker.start()
    try:
        with ApiServerInMemory() as before:
            port = int(before.url.rpartition(":")[2])
            before.put_config_map("a", "bridge", SETTINGS)
            stage = Stage(broker, before)
            stage.until(lambda: stage.receiver.channel.complaint is None, bridging=False)  # it has subscribed before
            stage.until(lambda: stage.channel.complaint is None)  # the other one connects
            stage.publish(b"before")
            stage.until(lambda: stage.receiver.messages == [b"before"])
        broker.stop()
        stage.until(lambda: stage.channel.complaint and stage.watch.interrupted_at)
        stage.publish(b"queued")
        stage.turn()
        stage.leap = CUT_SECONDS
        broker.start()
        stage.until(lambda: stage.receiver.channel.complaint is None and stage.channel.complaint is None)
        stage.publish(b"back")
        for _ in range(TURNS_AFTER):  # the broker takes everything, and nobody has said yet whose release it is
            stage.turn()
        assert stage.receiver.messages == [b"before"]
        after = ApiServerInMemory(port=port)
        after.put_config_map("a", "bridge", None if taken_over else SETTINGS)  # before it answers: the watch asks it
        with after:
            stage.watch.read_again()
            if taken_over:
                stage.until(lambda: stage.ownership.lost)
                stage.bridge.close()
            else:
                stage.until(lambda: len(stage.receiver.messages) == 3)
            for _ in range(TURNS_AFTER):
                stage.receiver.channel.turn(time.monotonic())
            stage.watch.stop()
        assert stage.receiver.messages == [b"before", *([] if taken_over else [b"queued", b"back"])]
        stage.bridge.close()
        stage.receiver.channel.close()
    finally:
        broker.stop()
