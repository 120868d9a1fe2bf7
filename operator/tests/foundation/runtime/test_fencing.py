"""A process whose node was cut off: nothing leaves before its settings were read anew, and nothing is lost if they are
still its own."""

from __future__ import annotations

import time
from typing import Any

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, ConfigMapWatch
from robotkube.foundation.runtime.config_watch import until_removed
from robotkube.foundation.runtime.loops.fencing import BOUND_SECONDS_MAX, FRESH_SECONDS, GAP_SECONDS_MAX, Fencing
from robotkube.foundation.runtime.process import PodSettings, Process
from robotkube.robots.bridge.core.settings import read_bridge_settings
from robotkube.robots.bridge.loops.bridge import Bridge
from robotkube.robots.bridge.loops.flows import SendingSession
from robotkube.robots.detector.adapters.api_tasks import ApiTasks
from robotkube.robots.mqtt.core.batches import decode_batch
from robotkube.testing.api_server import ApiServerInMemory
from tests.stages.bridge.memory_network import Channel, Network
from tests.stages.runtime.settings_reading import Reading
from tests.stages.waiting import until

POSE = {"name": "/vehicles/vehicle_00/pose", "type": "geometry_msgs/msg/PoseStamped"}
TRANSFORM = {
    "name": "/vehicles/vehicle_00/transform",
    "type": "geometry_msgs/msg/TransformStamped",
    "durability": "transient_local",
}
MOVABLE = {"movable": "true"}


class Stage:
    """A bridge whose clock and settings are the test's."""

    def __init__(self, movable: bool) -> None:
        self.now = 100.0
        self.reading = Reading()
        self.fencing = Fencing("edge-0", movable, lambda: self.now)
        self.fencing.watch(self.reading)
        self.network = Network()
        self.channels = dict[str, Channel]()
        sender = SendingSession(42, time.time_ns, lambda name: "")
        self.bridge = Bridge(self.network, self.channel, sender, lambda event, **fields: None, self.fencing)
        self.configure(POSE)
        self.channels["telemetry"].connect()
        if movable:
            self.read()

    def channel(self, agent: str, name: str, events: Any) -> Channel:
        self.channels[name] = Channel(f"{agent}-{name}", events)
        return self.channels[name]

    def configure(self, *out: Any) -> None:
        self.bridge.configure(read_bridge_settings({"agent": "vehicle-00", "out": list(out)}, "config.yaml"))

    def read(self, settings: Any = MOVABLE) -> None:
        """The API server answers."""
        self.fencing.observe(settings)
        self.reading.read_at = self.now
        self.reading.interrupted_at = None

    def turn(self, *messages: bytes) -> None:
        """What the process's loop does."""
        self.network.endpoint(POSE["name"]).waiting += messages
        held = self.fencing.fenced
        self.bridge.hold(held)
        self.bridge.turn(self.now)

    def cut(self, seconds: float) -> None:
        """Broker and API server are out of reach for so long; then the broker is back."""
        self.channels["telemetry"].lose()
        self.reading.interrupted_at = self.now
        self.now += seconds
        self.channels["telemetry"].connect()

    @property
    def sent(self) -> list[bytes]:
        """Messages that left."""
        frames = [decode_batch(payload) for _, payload, _ in self.channels["telemetry"].sent]
        return [message for frame in frames for message in frame.messages]

    def settle(self) -> None:
        """Turn until the outbox, which goes slowly after a reconnection, is empty."""
        for _ in range(20):
            self.turn()
            for token in range(1, len(self.channels["telemetry"].sent) + 1):
                self.channels["telemetry"].acknowledge(token)
            self.now += 0.05


@pytest.mark.parametrize("movable", [True, False])
def test_nothing_leaves_before_the_settings_were_read_and_nothing_is_lost_when_they_are_its_own(movable: bool) -> None:
    stage = Stage(movable)
    stage.turn(b"before")
    stage.channels["telemetry"].acknowledge(1)
    stage.channels["telemetry"].lose()
    stage.turn(b"queued")
    stage.cut(40.0)
    stage.turn(b"after")
    assert stage.sent == [b"before"]
    assert stage.reading.asked == 1
    stage.now += 2.0
    stage.turn()
    assert stage.sent == [b"before"]
    stage.read(MOVABLE if movable else {})
    stage.settle()
    assert stage.sent == [b"before", b"queued", b"after"]
    assert stage.reading.asked == 1


@pytest.mark.parametrize("settings", [None, {"node": "edge-1", **MOVABLE}])
def test_what_was_taken_over_is_never_sent(settings: Any) -> None:
    stage = Stage(movable=True)
    stage.channels["telemetry"].lose()
    stage.turn(b"queued")
    stage.cut(90.0)
    stage.now += 10_000.0  # however long it takes
    stage.turn(b"after")
    stage.read(settings)
    assert stage.fencing.lost
    stage.settle()
    stage.bridge.close()
    assert stage.sent == []


def test_a_topic_that_somebody_else_carries_by_now_is_left_alone() -> None:
    stage = Stage(movable=False)
    stage.configure(POSE, TRANSFORM)
    stage.network.endpoint(TRANSFORM["name"]).waiting = [b"kept"]
    stage.turn(b"before")
    sent = len(stage.channels["telemetry"].sent)
    stage.channels["telemetry"].lose()
    stage.turn(b"queued")
    stage.cut(90.0)
    stage.configure()  # read anew: the topics are another bridge's, with their retained message
    stage.read({})
    stage.bridge.hold(False)
    stage.bridge.turn(stage.now)
    assert len(stage.channels["telemetry"].sent) == sent


def test_a_bound_release_waits_for_a_stated_time_and_again_after_every_connection() -> None:
    stage = Stage(movable=False)
    stage.turn(b"first")
    for number in range(2):
        stage.cut(60.0)
        stage.now += BOUND_SECONDS_MAX - 0.1
        stage.turn()
        assert stage.fencing.fenced
        stage.now += 0.1
        assert not stage.fencing.fenced
        assert stage.reading.asked == number + 1


def test_settings_that_were_just_read_are_not_read_again() -> None:
    stage = Stage(movable=True)
    stage.cut(FRESH_SECONDS - 0.1)
    assert not stage.fencing.fenced
    assert stage.reading.asked == 0
    stage.now += 0.2
    for _ in range(2):  # both connections of a bridge come back
        stage.channels["telemetry"].lose()
        stage.channels["telemetry"].connect()
    assert stage.reading.asked == 1


def test_a_long_gap_alone_stops_what_could_be_taken_over_and_nothing_else() -> None:
    for movable in (True, False):
        stage = Stage(movable)
        stage.reading.interrupted_at = stage.now
        stage.now += GAP_SECONDS_MAX
        stage.turn(b"in time")
        assert stage.sent == [b"in time"]
        stage.now += 0.1
        stage.turn(b"late")
        assert stage.fencing.fenced is movable
        stage.read(MOVABLE if movable else {})
        stage.turn()
        assert stage.sent == [b"in time", b"late"]


def test_it_begins_with_reading_and_a_removal_that_it_hears_of_at_once_ends_it_in_good_order() -> None:
    reading = Reading()
    now = [0.0]
    fencing = Fencing("edge-0", True, lambda: now[0])
    assert fencing.fenced
    fencing.watch(reading)
    assert fencing.fenced
    assert fencing.observe(MOVABLE)
    reading.read_at = 0.0
    assert not fencing.fenced
    assert fencing.metrics() == "robotkube_settings_fenced 0\n"
    assert not fencing.observe(None)
    assert (fencing.fenced, fencing.lost) == (False, False)
    assert not Fencing().fenced


def test_tasks_are_not_written_while_nobody_knows() -> None:
    with ApiServerInMemory() as server:
        api = ApiServer(server.url)
        tasks = ApiTasks(api, "edge-0", Fencing("edge-0", True))
        for call in (lambda: tasks.create({}), lambda: tasks.delete("t"), lambda: tasks.renew("t", 0)):
            with pytest.raises(UnavailableError, match="read anew first"):
                call()
        assert tasks.tasks() == []
        api.close()


def test_the_watch_reads_again_when_it_is_asked_and_says_when_it_did() -> None:
    notified: list[object] = []
    with ApiServerInMemory() as server:
        port = int(server.url.rpartition(":")[2])
        server.put_config_map("a", "m", {"n": "1"})
        watch = ConfigMapWatch(ApiServer(server.url), "a", "m", notified.append)
        watch.start()
        until(lambda: watch.read_at is not None)
        before = time.monotonic()
        watch.read_again()
        until(lambda: (watch.read_at or 0.0) >= before)
        assert watch.complaint is None
    until(lambda: watch.interrupted_at is not None)
    again = ApiServerInMemory(port=port)
    again.put_config_map("a", "m", {"n": "1"})  # before it answers: the watch tries again all the time
    with again as server:
        watch.read_again()
        until(lambda: watch.interrupted_at is None)
        server.put_config_map("a", "m", {"n": "2"})
        until(lambda: notified[-1] == {"n": "2"})
        watch.stop()
    assert notified == [{"n": "1"}, {"n": "2"}]


def test_a_process_that_is_started_anew_after_its_release_went_does_nothing(tmp_path: Any) -> None:
    (tmp_path / "config.yaml").write_text("a: 1")
    (tmp_path / "movable").write_text("true")
    pod = PodSettings.from_environment({"ROBOTKUBE_CONFIG": str(tmp_path / "config.yaml"), "NODE_NAME": "edge-0"})
    assert (pod.movable, pod.node, pod.placed_node) == (True, "edge-0", "")
    process = Process("worker", 60.0)
    fencing = Fencing(pod.node, pod.movable)
    stopped: list[bool] = []
    process.stop = lambda: stopped.append(True)  # type: ignore[method-assign]
    until_removed(process, fencing, lambda data: None)(None)
    assert process.removed.is_set()
    assert stopped == [True]
    assert fencing.fenced
