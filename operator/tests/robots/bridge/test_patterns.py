"""Topics of any agent in both directions, without loops; types, formats and what is subscribed."""

from __future__ import annotations

import pytest

from robotkube.robots.bridge.core import mqtt_client_format as ika
from robotkube.robots.bridge.core.settings import TOPICS_MAX
from robotkube.robots.bridge.loops import flows
from robotkube.robots.bridge.loops.bridge import FORGET_SECONDS
from robotkube.robots.mqtt.core.batches import decode_batch, encode_batch
from robotkube.robots.mqtt.core.properties import read_properties
from robotkube.robots.ros.core.graph import Endpoint
from tests.stages.bridge.in_memory import EVERYBODY, POSE, TRACE, BridgeStage

OTHER = "/vehicles/vehicle_03/pose"
IKA = {**POSE, "format": "mqtt_client"}
MESSAGE = b"\0\1\0\0message"


def published(topic: str, node: str = "/player", kind: str = POSE["type"]) -> Endpoint:
    return Endpoint(topic, "out", kind, "reliable", "volatile", node)


def test_topics_are_found_in_the_ros_network_and_forgotten_again() -> None:
    world = BridgeStage()
    world.network.others = [
        published(POSE["name"]),
        published("/other"),
        published(OTHER, kind="x/msg/Y"),
        published("/vehicles/vehicle_05/pose", node=""),
    ]
    world.configure(out=[EVERYBODY])
    world.connect()
    world.bridge.turn(0.0)
    world.network.endpoint(POSE["name"]).waiting = [b"x"]
    world.bridge.turn(1.0)
    assert [e.topic for e in world.network.made] == [POSE["name"]]
    assert [topic for topic, _, _ in world.channels["telemetry"].sent] == ["mqtt" + POSE["name"]]
    world.network.others = []
    world.bridge.turn(1.0 + FORGET_SECONDS)
    assert not world.network.endpoint(POSE["name"]).closed
    world.bridge.turn(3.0 + FORGET_SECONDS)
    assert [e.topic for e in world.network.made if e.closed] == [POSE["name"]]


def test_topics_of_others_are_found_at_the_broker() -> None:
    world = BridgeStage()
    world.configure(into=[EVERYBODY])
    world.connect()
    telemetry = world.channels["telemetry"]
    assert telemetry.subscribed == ["mqtt/vehicles/+/pose"]
    for sequence in range(2):
        telemetry.events.received("mqtt" + OTHER, encode_batch(1, sequence, [b"%d" % sequence]), b"")
        telemetry.events.received("mqtt" + POSE["name"], encode_batch(1, sequence, [b"own"]), b"")
    assert [(e.topic, e.published) for e in world.network.made] == [(OTHER, [b"0", b"1"])]
    assert telemetry.subscribed == ["mqtt/vehicles/+/pose"]
    world.configure()
    assert telemetry.unsubscribed == ["mqtt/vehicles/+/pose"]
    assert [e.topic for e in world.network.made if e.closed] == [OTHER]


def test_what_cannot_be_opened_is_bounded_and_forgotten_with_its_settings() -> None:
    world = BridgeStage()
    world.configure(into=[{**EVERYBODY, "type": "nowhere/msg/Odd"}])
    world.connect()
    receive, batches = world.channels["telemetry"].events.received, iter(range(10_000))

    def come(agent: str) -> None:
        receive(f"mqtt/vehicles/{agent}/pose", encode_batch(1, next(batches), [b"pose"]), b"")

    for number in range(2 * TOPICS_MAX):
        come(f"agent_{number}")
    come("a" * 64)
    assert str(world.bridge.not_carried).count("is not carried") == TOPICS_MAX
    assert "a" * 64 not in str(world.bridge.not_carried)
    world.configure()
    assert world.bridge.not_carried == []
    world.configure(into=[EVERYBODY])
    come("agent_0")
    assert world.network.endpoint("/vehicles/agent_0/pose").published == [b"pose"]


def test_what_comes_in_does_not_go_out_and_what_goes_out_does_not_come_in() -> None:
    world = BridgeStage()
    world.configure(out=[EVERYBODY], into=[EVERYBODY])
    world.connect()
    telemetry = world.channels["telemetry"]
    telemetry.events.received("mqtt" + OTHER, encode_batch(1, 0, [b"in"]), b"")
    bridged = published("/vehicles/vehicle_07/pose", node="/mqtt_bridge")
    world.network.others = [published(OTHER), published(POSE["name"]), bridged]
    world.bridge.turn(1.0)
    assert [e.topic for e in world.network.made] == [OTHER, POSE["name"]]
    telemetry.events.received("mqtt" + POSE["name"], encode_batch(9, 0, [b"back"]), b"")
    world.network.endpoint(POSE["name"]).waiting = [b"out"]
    world.bridge.turn(2.0)
    assert [decode_batch(data).messages for _, data, _ in telemetry.sent] == [(b"out",)]
    assert world.network.endpoint(POSE["name"]).published == []


def test_a_topic_that_is_named_stays_when_all_are_asked_for() -> None:
    """What stays has no gap: first the new subscription, then the old one's end, and the publisher is the same."""
    world = BridgeStage()
    named = {**POSE, "name": OTHER}
    world.configure(into=[named])
    world.connect()
    telemetry, sink = world.channels["telemetry"], world.network.endpoint(OTHER)
    world.configure(into=[named, EVERYBODY])
    assert telemetry.subscribed == ["mqtt" + OTHER, "mqtt/vehicles/+/pose"]
    assert telemetry.unsubscribed == ["mqtt" + OTHER]
    telemetry.events.received("mqtt" + OTHER, encode_batch(1, 0, [b"0"]), b"")
    world.configure(into=[named])
    assert telemetry.subscribed[2:] == ["mqtt" + OTHER]
    assert telemetry.unsubscribed[1:] == ["mqtt/vehicles/+/pose"]
    telemetry.events.received("mqtt" + OTHER, encode_batch(1, 1, [b"1"]), b"")
    assert (sink.published, sink.closed) == ([b"0", b"1"], False)


def test_the_middleware_gets_nothing_before_somebody_listens() -> None:
    world = BridgeStage()
    world.configure(into=[POSE])
    world.connect()
    sink = world.network.endpoint(POSE["name"])
    sink.matched = 0
    receive = world.channels["telemetry"].events.received
    receive("mqtt" + POSE["name"], encode_batch(1, 0, [b"0"]), b"")
    world.bridge.turn(0.1)
    assert sink.published == []
    sink.matched = 1
    world.bridge.turn(0.2)
    receive("mqtt" + POSE["name"], encode_batch(1, 1, [b"1"]), b"")
    assert sink.published == [b"0", b"1"]


@pytest.mark.parametrize("seconds", [0.0, flows.HOLD_SECONDS_MAX])
def test_holding_is_bounded(seconds: float) -> None:
    world = BridgeStage()
    world.configure(into=[POSE])
    world.connect()
    sink = world.network.endpoint(POSE["name"])
    sink.matched = 0
    count = 1 if seconds else flows.HELD_MESSAGES_MAX + 1
    batch = encode_batch(1, 0, [b"x"] * count)
    world.channels["telemetry"].events.received("mqtt" + POSE["name"], batch, b"")
    world.now_ns += int(seconds * 1e9)
    world.bridge.turn(0.0)
    assert len(sink.published) == count


def test_messages_say_what_they_are() -> None:
    world = BridgeStage()
    world.configure(out=[POSE], publish_types=True, trace="cd" * 16)
    world.connect()
    world.network.endpoint(POSE["name"]).waiting = [b"\0\1\0\0" + bytes(4) + b"\x07\0\0\0rest"]
    world.bridge.turn(0.0)
    telemetry = world.channels["telemetry"]
    (types, text, retained), _ = telemetry.sent
    assert (types, text, retained) == (
        "robotkube/types/mqtt" + POSE["name"],
        b"definition of " + POSE["type"].encode(),
        True,
    )
    assert read_properties(telemetry.properties[0]).user == {"type": POSE["type"]}
    properties = read_properties(telemetry.properties[1])
    assert properties.content_type == "application/x-robotkube-frames"
    assert properties.user == {"type": POSE["type"], "trace": "cd" * 16, "stamp": "7"}
    world.configure(publish_types=True)
    world.bridge.turn(1.0)
    assert telemetry.sent[-1] == (types, b"", True)


def test_without_a_trace_of_a_task_the_process_has_one() -> None:
    world = BridgeStage()
    world.configure(out=[POSE])
    world.connect()
    world.network.endpoint(POSE["name"]).waiting = [b"x"]
    world.bridge.turn(0.0)
    assert read_properties(world.channels["telemetry"].properties[0]).user["trace"] == TRACE


def test_mqtt_client_gets_its_type_and_one_message_each() -> None:
    world = BridgeStage()
    world.configure(out=[{**IKA, "inject_timestamp": True, "mqtt_topic": "pingpong/ros"}])
    world.connect()
    world.network.endpoint(POSE["name"]).waiting = [MESSAGE, MESSAGE]
    world.bridge.turn(0.0)
    kind = ika.encode_type(ika.RosMessageType(POSE["type"], True))
    stamped = ("pingpong/ros", ika.encode_message(MESSAGE, world.now_ns), False)
    assert world.channels["telemetry"].sent == [("mqtt_client/ros_msg_type/pingpong/ros", kind, True), stamped, stamped]


@pytest.mark.parametrize(("topic", "name"), [(IKA, POSE["name"]), ({**IKA, "name": EVERYBODY["name"]}, OTHER)])
@pytest.mark.parametrize("stamped", [True, False])
def test_messages_of_mqtt_client_are_asked_for_once_their_type_is_known(
    topic: dict[str, str], name: str, stamped: bool
) -> None:
    world = BridgeStage()
    world.configure(into=[topic])
    world.connect()
    telemetry = world.channels["telemetry"]
    asked = "mqtt_client/ros_msg_type/mqtt" + topic["name"].replace("{agent}", "+")
    assert telemetry.subscribed == [asked]
    kind = ika.encode_type(ika.RosMessageType(POSE["type"], stamped))
    telemetry.events.received("mqtt_client/ros_msg_type/mqtt" + name, kind, b"")
    assert telemetry.subscribed == [asked, "mqtt" + name]
    telemetry.events.received("mqtt" + name, ika.encode_message(MESSAGE, 5 if stamped else None), b"")
    assert world.network.endpoint(name).published == [MESSAGE]
    assert ("latency_seconds" in world.bridge.metrics()) == stamped
    world.configure()
    assert set(telemetry.unsubscribed) == {asked, "mqtt" + name}


def test_mqtt_client_with_another_type_is_refused_in_words() -> None:
    world = BridgeStage()
    world.configure(into=[IKA])
    world.connect()
    kind = ika.encode_type(ika.RosMessageType("std_msgs/msg/String", False))
    world.channels["telemetry"].events.received("mqtt_client/ros_msg_type/mqtt" + POSE["name"], kind, b"")
    assert "its type is std_msgs/msg/String, that of the topic geometry_msgs" in str(world.logged("batch refused"))
    assert len(world.channels["telemetry"].subscribed) == 1


def test_messages_of_mqtt_client_are_never_published_as_another_type() -> None:
    """Neither what a session older than the process brings before its type, nor what follows a change of the type."""
    world = BridgeStage()
    world.configure(into=[IKA])
    world.connect()
    telemetry, name = world.channels["telemetry"], "mqtt" + POSE["name"]

    def announce(type_name: str) -> None:
        kind = ika.encode_type(ika.RosMessageType(type_name, True))
        telemetry.events.received("mqtt_client/ros_msg_type/" + name, kind, b"")

    stamped = ika.encode_message(MESSAGE, 5)
    telemetry.events.received(name, stamped, b"")
    announce(POSE["type"])
    for _ in range(2):
        announce(POSE["type"])
        telemetry.events.received(name, stamped, b"")
    announce("std_msgs/msg/String")
    assert telemetry.unsubscribed == [name]
    telemetry.events.received(name, stamped, b"")
    announce(POSE["type"])
    telemetry.events.received(name, stamped, b"")
    assert world.network.endpoint(POSE["name"]).published == [MESSAGE] * 3
    assert telemetry.subscribed.count(name) == 2
    assert 'refused_batches_total{channel="telemetry"} 3' in world.bridge.metrics()
