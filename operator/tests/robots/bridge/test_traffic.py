"""Kinds of traffic in a bridge: who waits for whom, what is late, what is thinned, and how a backlog leaves."""

from __future__ import annotations

from typing import Any

from benchmarks.measuring.bags import message
from robotkube.robots.bridge.core.outbox import LATE, MANY
from robotkube.robots.bridge.core.pacing import FRESH_SECONDS, SPEED
from robotkube.robots.mqtt.core.batches import decode_batch
from robotkube.robots.mqtt.core.properties import message_expiry
from robotkube.robots.ros.core.common_messages import header_stamp
from tests.stages.bridge.in_memory import CLOUD, POSE, BridgeStage
from tests.stages.bridge.memory_network import Channel

BRAKE = {**POSE, "name": "/vehicles/vehicle_00/brake", "channel": "safety"}
WISH = {**POSE, "name": "/vehicles/vehicle_00/wish", "deadline_seconds": 0.5}
MAP = {**CLOUD, "name": "/vehicles/vehicle_00/map"}
CLOUD_BYTES = 320_000
TURN_SECONDS = 0.04


class Sending:
    """A bridge that sends `topics`; the number of a message is its stamp."""

    def __init__(self, *topics: dict[str, Any]) -> None:
        self.stage = BridgeStage()
        self.stage.configure(out=list(topics))
        self.stage.connect()
        self.now = 0.0

    def channel(self, name: str) -> Channel:
        return self.stage.channels[name]

    def put(self, topic: dict[str, Any], *numbers: int, size: int = 76) -> None:
        self.stage.network.endpoint(topic["name"]).waiting += [message(number, number, size) for number in numbers]

    def turn(self, seconds: float = TURN_SECONDS) -> None:
        self.now += seconds
        self.stage.bridge.turn(self.now)

    def sent(self, topic: dict[str, Any]) -> list[int]:
        """The numbers that went to the broker, in their order."""
        channel = self.channel(topic.get("channel", "telemetry"))
        batches = [payload for name, payload, _ in channel.sent if name == "mqtt" + topic["name"]]
        return [header_stamp(data) for payload in batches for data in decode_batch(payload).messages]

    def acknowledge(self, channel: str) -> None:
        """The broker has everything that went there."""
        for token in range(1, len(self.channel(channel).sent) + 1):
            self.channel(channel).acknowledge(token)

    def dropped(self, topic: dict[str, Any]) -> dict[str, int]:
        """Reason -> messages of the topic that were given up, by the metrics."""
        begin = f'robotkube_bridge_dropped_messages_total{{channel="{topic.get("channel", "telemetry")}"'
        lines = [line for line in self.stage.bridge.metrics().splitlines() if line.startswith(begin)]
        own = [line for line in lines if f'topic="{topic["name"]}"' in line]
        return {line.partition('why="')[2].partition('"')[0]: int(line.rpartition(" ")[2]) for line in own}


def test_each_kind_waits_while_a_more_urgent_one_does_not_get_through() -> None:
    sending = Sending(CLOUD, POSE, BRAKE)
    for topic in (CLOUD, POSE, BRAKE):
        sending.put(topic, 1)
    sending.channel("telemetry").congested = True
    sending.turn()
    assert (sending.sent(BRAKE), sending.sent(POSE), sending.sent(CLOUD)) == ([1], [1], [])
    assert sending.stage.bridge.yielding == {"bulk"}
    sending.put(POSE, 2)
    sending.channel("telemetry").congested = False
    sending.channel("safety").congested = True
    sending.turn()
    assert (sending.sent(POSE), sending.sent(CLOUD)) == ([1], [])
    assert sending.stage.bridge.yielding == {"telemetry", "bulk"}
    sending.channel("safety").congested = False
    sending.turn()
    assert (sending.sent(POSE), sending.sent(CLOUD)) == ([1, 2], [1])
    assert sending.stage.bridge.yielding == set()


def test_what_only_comes_in_waits_for_nobody() -> None:
    sending = Sending(POSE)
    sending.stage.configure(out=[POSE], into=[{**CLOUD, "name": "/vehicles/vehicle_01/cloud"}])
    sending.stage.connect()
    sending.channel("telemetry").congested = True
    sending.turn()
    assert sending.stage.bridge.yielding == set()


def test_a_socket_that_is_full_is_given_nothing_more() -> None:
    sending = Sending(POSE)
    sending.put(POSE, 1)
    sending.turn()
    sending.channel("telemetry").wants_write = True
    sending.put(POSE, 2)
    sending.turn()
    assert sending.sent(POSE) == [1]
    sending.channel("telemetry").wants_write = False
    sending.turn()
    assert sending.sent(POSE) == [1, 2]


def test_of_many_large_batches_a_full_socket_gets_one() -> None:
    sending = Sending(CLOUD)
    channel = sending.channel("bulk")
    channel.flush = lambda: setattr(channel, "wants_write", True)  # type: ignore[method-assign]
    channel.wants_write = False
    for number in range(3):
        sending.put(CLOUD, number, size=800_000)
    sending.turn()
    assert sending.sent(CLOUD) == [0]


def test_late_messages_are_dropped_and_counted_and_no_others() -> None:
    sending = Sending(POSE, WISH)
    sending.channel("telemetry").lose()
    for number in range(20):
        sending.put(POSE, number)
        sending.put(WISH, number)
        sending.turn(0.1)
    sending.channel("telemetry").connect()
    for _ in range(40):
        sending.turn(0.0)
        sending.acknowledge("telemetry")
    assert sending.sent(WISH) == [15, 16, 17, 18, 19]
    assert sending.dropped(WISH) == {LATE: 15}
    assert sending.dropped(POSE) == {}


def test_what_has_a_deadline_goes_before_a_backlog() -> None:
    sending = Sending(POSE, WISH)
    sending.channel("telemetry").lose()
    for number in range(100):
        sending.put(POSE, number)
        sending.turn(0.1)
    sending.channel("telemetry").connect()
    sending.turn()
    sending.acknowledge("telemetry")
    sending.put(WISH, 1)
    sending.turn()
    assert sending.sent(WISH) == [1]
    assert len(sending.sent(POSE)) < 50, "most of the backlog still waits"


def test_the_broker_keeps_no_message_beyond_its_deadline() -> None:
    sending = Sending(POSE, WISH)
    sending.put(WISH, 1)
    sending.put(POSE, 1)
    sending.turn()
    channel = sending.channel("telemetry")
    sent = zip(channel.sent, channel.properties, strict=True)
    expiries = {name: message_expiry(0.5) in properties for (name, _, _), properties in sent}
    assert expiries == {"mqtt" + WISH["name"]: True, "mqtt" + POSE["name"]: False}


def test_a_topic_that_needs_most_is_thinned_first_and_what_is_missing_is_counted() -> None:
    sending = Sending(CLOUD, MAP)
    sending.channel("bulk").lose()
    sending.put(MAP, 1000, size=CLOUD_BYTES)
    for number in range(15):
        sending.put(CLOUD, number, size=CLOUD_BYTES)
        sending.turn()
    sending.channel("bulk").connect()
    for _ in range(15):
        sending.turn()
        sending.acknowledge("bulk")
    assert sending.sent(MAP) == [1000]
    assert sending.sent(CLOUD) == list(range(6, 15))
    assert sending.dropped(CLOUD) == {MANY: 6}
    assert sending.dropped(MAP) == {}


def test_a_backlog_leaves_faster_than_it_came_and_not_at_once() -> None:
    sending = Sending(POSE)
    sending.channel("telemetry").lose()
    for number in range(500):  # 20 s
        sending.put(POSE, number)
        sending.turn()
    sending.channel("telemetry").connect()
    turns: list[int] = []
    number = 500
    while len(sending.sent(POSE)) < number:
        before = len(sending.sent(POSE))
        sending.put(POSE, number)
        number += 1
        sending.turn()
        sending.acknowledge("telemetry")
        turns.append(len(sending.sent(POSE)) - before)
    assert sending.sent(POSE) == list(range(number)), "everything, in its order"
    assert max(turns[:-1]) <= SPEED + 1, "a turn brings no more than its share"
    assert turns[-1] <= FRESH_SECONDS / TURN_SECONDS + SPEED + 1
    assert len(turns) < 500 / (SPEED - 1) + 10
    assert 'robotkube_bridge_paced{channel="telemetry"} 0' in sending.stage.bridge.metrics()


def test_silence_in_a_backlog_is_not_waited_for() -> None:
    sending = Sending(POSE)
    sending.channel("telemetry").lose()
    for number in range(3):
        sending.put(POSE, number)
        sending.turn(15.0)
    sending.channel("telemetry").connect()
    for _ in range(20):
        sending.turn()
        sending.acknowledge("telemetry")
    assert sending.sent(POSE) == [0, 1, 2]


def test_what_is_retained_waits_for_no_backlog() -> None:
    state = {**POSE, "name": "/vehicles/vehicle_00/state", "durability": "transient_local"}
    sending = Sending(POSE, state)
    sending.put(state, 1)
    sending.turn()
    sending.turn(100.0)
    sending.channel("telemetry").lose()
    sending.channel("telemetry").connect()
    sending.turn()
    assert sending.sent(state) == [1, 1]
