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
    stage = BridgeStage()
    stage.network.others = [
        published(POSE["name"]),
        published("/other"),
        published(OTHER, kind="x/msg/Y"),
        published("/vehicles/vehicle_05/pose", node=""),
    ]
    stage.configure(out=[EVERYBODY])
    stage.connect()
    stage.bridge.turn(0.0)
    stage.network.endpoint(POSE["name"]).waiting = [b"x"]
    stage.bridge.turn(1.0)
    assert [e.topic for e in stage.network.made] == [POSE["name"]]
    assert [topic for topic, _, _ in stage.channels["telemetry"].sent] == ["mqtt" + POSE["name"]]
    stage.network.others = []
    stage.bridge.turn(1.0 + FORGET_SECONDS)
    assert not stage.network.endpoint(POSE["name"]).closed
    stage.bridge.turn(3.0 + FORGET_SECONDS)
    assert [e.topic for e in stage.network.made if e.closed] == [POSE["name"]]


def test_topics_of_others_are_found_at_the_broker() -> None:
    stage = BridgeStage()
    stage.configure(into=[EVERYBODY])
    stage.connect()
    telemetry = stage.channels["telemetry"]
    assert telemetry.subscribed == ["mqtt/vehicles/+/pose"]
    for sequence in range(2):
        telemetry.events.received("mqtt" + OTHER, encode_batch(1, sequence, [b"%d" % sequence]), b"")
        telemetry.events.received("mqtt" + POSE["name"], encode_batch(1, sequence, [b"own"]), b"")
    assert [(e.topic, e.published) for e in stage.network.made] == [(OTHER, [b"0", b"1"])]
    assert telemetry.subscribed == ["mqtt/vehicles/+/pose"]
    stage.configure()
    assert telemetry.unsubscribed == ["mqtt/vehicles/+/pose"]
    assert [e.topic for e in stage.network.made if e.closed] == [OTHER]


def test_what_cannot_be_opened_is_bounded_and_forgotten_with_its_settings() -> None:
    stage = BridgeStage()
    stage.configure(into=[{**EVERYBODY, "type": "nowhere/msg/Odd"}])
    stage.connect()
    receive = stage.channels["telemetry"].events.received
    batches = iter(range(10_000))

    def come(agent: str) -> None:
        receive(f"mqtt/vehicles/{agent}/pose", encode_batch(1, next(batches), [b"pose"]), b"")

    for number in range(2 * TOPICS_MAX):
        come(f"agent_{number}")
    come("a" * 64)
    assert str(stage.bridge.not_carried).count("is not carried") == TOPICS_MAX
    assert "a" * 64 not in str(stage.bridge.not_carried)
    stage.configure()
    assert stage.bridge.not_carried == []
    stage.configure(into=[EVERYBODY])
    come("agent_0")
    assert stage.network.endpoint("/vehicles/agent_0/pose").published == [b"pose"]


def test_what_comes_in_does_not_go_out_and_what_goes_out_does_not_come_in() -> None:
    stage = BridgeStage()
    stage.configure(out=[EVERYBODY], into=[EVERYBODY])
    stage.connect()
    telemetry = stage.channels["telemetry"]
    telemetry.events.received("mqtt" + OTHER, encode_batch(1, 0, [b"in"]), b"")
    bridged = published("/vehicles/vehicle_07/pose", node="/mqtt_bridge")
    stage.network.others = [published(OTHER), published(POSE["name"]), bridged]
    stage.bridge.turn(1.0)
    assert [e.topic for e in stage.network.made] == [OTHER, POSE["name"]]
    telemetry.events.received("mqtt" + POSE["name"], encode_batch(9, 0, [b"back"]), b"")
    stage.network.endpoint(POSE["name"]).waiting = [b"out"]
    stage.bridge.turn(2.0)
    assert [decode_batch(data).messages for _, data, _ in telemetry.sent] == [(b"out",)]
    assert stage.network.endpoint(POSE["name"]).published == []


def test_a_topic_that_is_named_stays_when_all_are_asked_for() -> None:
    """What stays has no gap: first the new subscription, then the old one's end, and the publisher is the same."""
    stage = BridgeStage()
    named = {**POSE, "name": OTHER}
    stage.configure(into=[named])
    stage.connect()
    telemetry = stage.channels["telemetry"]
    sink = stage.network.endpoint(OTHER)
    stage.configure(into=[named, EVERYBODY])
    assert telemetry.subscribed == ["mqtt" + OTHER, "mqtt/vehicles/+/pose"]
    assert telemetry.unsubscribed == ["mqtt" + OTHER]
    telemetry.events.received("mqtt" + OTHER, encode_batch(1, 0, [b"0"]), b"")
    stage.configure(into=[named])
    assert telemetry.subscribed[2:] == ["mqtt" + OTHER]
    assert telemetry.unsubscribed[1:] == ["mqtt/vehicles/+/pose"]
    telemetry.events.received("mqtt" + OTHER, encode_batch(1, 1, [b"1"]), b"")
    assert (sink.published, sink.closed) == ([b"0", b"1"], False)


def test_the_middleware_gets_nothing_before_somebody_listens() -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    stage.connect()
    sink = stage.network.endpoint(POSE["name"])
    sink.matched = 0
    receive = stage.channels["telemetry"].events.received
    receive("mqtt" + POSE["name"], encode_batch(1, 0, [b"0"]), b"")
    stage.bridge.turn(0.1)
    assert sink.published == []
    sink.matched = 1
    stage.bridge.turn(0.2)
    receive("mqtt" + POSE["name"], encode_batch(1, 1, [b"1"]), b"")
    assert sink.published == [b"0", b"1"]


@pytest.mark.parametrize("seconds", [0.0, flows.HOLD_SECONDS_MAX])
def test_holding_is_bounded(seconds: float) -> None:
    stage = BridgeStage()
    stage.configure(into=[POSE])
    stage.connect()
    sink = stage.network.endpoint(POSE["name"])
    sink.matched = 0
    count = 1 if seconds else flows.HELD_MESSAGES_MAX + 1
    batch = encode_batch(1, 0, [b"x"] * count)
    stage.channels["telemetry"].events.received("mqtt" + POSE["name"], batch, b"")
    stage.now_ns += int(seconds * 1e9)
    stage.bridge.turn(0.0)
    assert len(sink.published) == count


def test_messages_say_what_they_are() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE], publish_types=True, trace="cd" * 16)
    stage.connect()
    stage.network.endpoint(POSE["name"]).waiting = [b"\0\1\0\0" + bytes(4) + b"\x07\0\0\0rest"]
    stage.bridge.turn(0.0)
    telemetry = stage.channels["telemetry"]
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
    stage.configure(publish_types=True)
    stage.bridge.turn(1.0)
    assert telemetry.sent[-1] == (types, b"", True)


def test_without_a_trace_of_a_task_the_process_has_one() -> None:
    stage = BridgeStage()
    stage.configure(out=[POSE])
    stage.connect()
    stage.network.endpoint(POSE["name"]).waiting = [b"x"]
    stage.bridge.turn(0.0)
    assert read_properties(stage.channels["telemetry"].properties[0]).user["trace"] == TRACE


def test_mqtt_client_gets_its_type_and_one_message_each() -> None:
    stage = BridgeStage()
    stage.configure(out=[{**IKA, "inject_timestamp": True, "mqtt_topic": "pingpong/ros"}])
    stage.connect()
    stage.network.endpoint(POSE["name"]).waiting = [MESSAGE, MESSAGE]
    stage.bridge.turn(0.0)
    kind = ika.encode_type(ika.RosMessageType(POSE["type"], True))
    stamped = ("pingpong/ros", ika.encode_message(MESSAGE, stage.now_ns), False)
    assert stage.channels["telemetry"].sent == [("mqtt_client/ros_msg_type/pingpong/ros", kind, True), stamped, stamped]


@pytest.mark.parametrize(("topic", "name"), [(IKA, POSE["name"]), ({**IKA, "name": EVERYBODY["name"]}, OTHER)])
@pytest.mark.parametrize("stamped", [True, False])
def test_messages_of_mqtt_client_are_asked_for_once_their_type_is_known(
    topic: dict[str, str], name: str, stamped: bool
) -> None:
    stage = BridgeStage()
    stage.configure(into=[topic])
    stage.connect()
    telemetry = stage.channels["telemetry"]
    asked = "mqtt_client/ros_msg_type/mqtt" + topic["name"].replace("{agent}", "+")
    assert telemetry.subscribed == [asked]
    kind = ika.encode_type(ika.RosMessageType(POSE["type"], stamped))
    telemetry.events.received("mqtt_client/ros_msg_type/mqtt" + name, kind, b"")
    assert telemetry.subscribed == [asked, "mqtt" + name]
    telemetry.events.received("mqtt" + name, ika.encode_message(MESSAGE, 5 if stamped else None), b"")
    assert stage.network.endpoint(name).published == [MESSAGE]
    assert ("latency_seconds" in stage.bridge.metrics()) == stamped
    stage.configure()
    assert set(telemetry.unsubscribed) == {asked, "mqtt" + name}


def test_mqtt_client_with_another_type_is_refused_in_words() -> None:
    stage = BridgeStage()
    stage.configure(into=[IKA])
    stage.connect()
    kind = ika.encode_type(ika.RosMessageType("std_msgs/msg/String", False))
    stage.channels["telemetry"].events.received("mqtt_client/ros_msg_type/mqtt" + POSE["name"], kind, b"")
    assert "its type is std_msgs/msg/String, that of the topic geometry_msgs" in str(stage.logged("batch refused"))
    assert len(stage.channels["telemetry"].subscribed) == 1


def test_messages_of_mqtt_client_are_never_published_as_another_type() -> None:
    """Neither what a session older than the process brings before its type, nor what follows a change of the type."""
    stage = BridgeStage()
    stage.configure(into=[IKA])
    stage.connect()
    telemetry = stage.channels["telemetry"]
    name = "mqtt" + POSE["name"]

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
    assert stage.network.endpoint(POSE["name"]).published == [MESSAGE] * 3
    assert telemetry.subscribed.count(name) == 2
    assert 'refused_batches_total{channel="telemetry"} 3' in stage.bridge.metrics()
