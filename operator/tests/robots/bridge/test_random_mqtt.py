"""Random MQTT messages, 200 as a rule and 20,000 in the thorough run: no crash, no hang, memory bounded, and a good
message afterwards still arrives."""

from __future__ import annotations

import random
import struct
import tracemalloc
from contextlib import suppress
from typing import Any

import pytest

from benchmarks.measuring.bags import message
from robotkube.robots.bridge.core import mqtt_client_format as ika
from robotkube.robots.mqtt.adapters.paho_client import MqttClient
from robotkube.robots.mqtt.core.batches import MAGIC, encode_batch
from robotkube.robots.mqtt.core.message_properties import GAPS_TOPIC, stamp_property, type_properties
from robotkube.robots.mqtt.core.packets import MalformedPacketError, write_number
from robotkube.robots.mqtt.core.properties import user_property
from tests.stages.bridge.in_memory import EVERYBODY, POSE, BridgeStage

SEED = 20_261_122
MEMORY_BYTES_MAX = 32 * 1024 * 1024
IKA = {**POSE, "name": "/vehicles/vehicle_04/ika", "format": "mqtt_client"}
CASES = pytest.mark.parametrize("cases", [200, pytest.param(20_000, marks=pytest.mark.thorough)])


def payloads(random_: random.Random) -> bytes:
    """Bytes of any kind: noise, batches that are cut, or lie about their counts and lengths, other formats."""
    pose = message(random_.randrange(2**40), random_.randrange(2**60), random_.randrange(20, 200))
    batch = encode_batch(random_.randrange(2**64), random_.randrange(2**64), [pose] * random_.randrange(5))
    kind = random_.randrange(8)
    if kind == 0:
        return random_.randbytes(random_.randrange(300))
    if kind == 1:
        return batch[: random_.randrange(len(batch))]
    if kind == 2:
        return MAGIC + random_.randbytes(16) + struct.pack("<I", random_.randrange(2**32)) + random_.randbytes(40)
    if kind == 3:
        head = MAGIC + bytes(16) + struct.pack("<II", 1, random_.randrange(2**32))
        return head + random_.randbytes(random_.randrange(60))
    if kind == 4:
        changed = bytearray(batch)
        changed[random_.randrange(len(changed))] = random_.randrange(256)
        return bytes(changed)
    if kind == 5:
        return ika.encode_type(ika.RosMessageType(random_.choice([POSE["type"], "x/msg/Y", "\0" * 40]), True))
    return batch if kind == 6 else ika.encode_message(pose, random_.choice([None, 17]))


def properties(random_: random.Random) -> bytes:
    """Good ones, other ones, noise."""
    good = type_properties(random_.choice([POSE["type"], "x/msg/Y"]), "") + stamp_property(random_.randrange(2**60))
    gaps = random_.choice(["[]", "[{}]", "{", "[" * 900, '[{"topic": 1}]', "null", "9" * 500])
    return random_.choice(
        [b"", good, good[: random_.randrange(len(good))], random_.randbytes(30), good + user_property("gaps", gaps)]
    )


def topics(random_: random.Random) -> str:
    """Known ones, ones of any agent, and others."""
    agent = random_.choice(["vehicle_00", "vehicle_03", f"vehicle_{random_.randrange(10**6)}", "", "+", "Ä", "a/b"])
    names = [
        f"mqtt/vehicles/{agent}/pose",
        "mqtt" + IKA["name"],
        "",
        "/",
        "mqtt",
        random_.randbytes(9).decode("latin-1"),
    ]
    name = random_.choice(names)
    return random_.choice([name, ika.TYPE_PREFIX + name, "robotkube/task_status/vehicle-00"])


@CASES
def test_any_message_at_any_topic(cases: int) -> None:
    random_ = random.Random(SEED)  # noqa: S311 - repeatable, not secret
    stage = BridgeStage()
    status = {"name": "/robotkube/task_status", "type": "std_msgs/msg/String"}
    stage.configure(into=[EVERYBODY, IKA, status], publish_gaps=True)
    stage.connect()
    events = stage.channels["telemetry"].events
    tracemalloc.start()
    try:
        for case in range(cases):
            events.received(topics(random_), payloads(random_), properties(random_))
            if case % 50:
                continue
            stage.bridge.turn(case / 100)
            for endpoint in stage.network.made:
                endpoint.published.clear()
            stage.channels["telemetry"].unsubscribed.clear()
            stage.lines.clear()
            stage.events.clear()
        assert tracemalloc.get_traced_memory()[0] < MEMORY_BYTES_MAX
    finally:
        tracemalloc.stop()
    known = [endpoint.topic for endpoint in stage.network.made]
    assert len(known) <= 502
    assert {GAPS_TOPIC, IKA["name"], "/vehicles/vehicle_03/pose"} <= set(known)
    events.received("mqtt/vehicles/vehicle_03/pose", encode_batch(1, 1, [b"good"]), b"")
    assert stage.network.endpoint("/vehicles/vehicle_03/pose").published == [b"good"]
    assert 'refused_batches_total{channel="telemetry"} 0' not in stage.bridge.metrics()


@CASES
def test_any_bytes_of_a_broker(cases: int) -> None:
    """A connection takes packets, or ends; nothing else. Whole packets with random content come, too."""
    random_ = random.Random(SEED)  # noqa: S311 - repeatable, not secret
    got = 0

    def received(*_: Any) -> None:
        nonlocal got
        got += 1

    for _ in range(cases):
        client = MqttClient("x", received, lambda mid, reason: None)
        content = random_.randbytes(random_.randrange(40))
        kinds = [random_.randrange(256), 0x30, 0x32, 0x40]
        packet = bytes((random_.choice(kinds),)) + write_number(len(content)) + content
        topic = struct.pack("!H", 3) + b"a/b" + b"\0\1" + bytes((random_.randrange(6),)) + content
        publish = b"\x32" + write_number(len(topic)) + topic
        client._buffer += random_.choice([packet, publish, packet * 3, content, publish[:-1] + packet])
        with suppress(MalformedPacketError):
            client._handle_buffer()
        assert len(client._buffer) < 200
    assert got > cases / 20


def test_a_packet_that_would_not_fit_into_memory_ends_the_connection() -> None:
    client = MqttClient("x", lambda *_: None, lambda *_: None)
    client._buffer += b"\x30" + write_number(200_000_000)
    with pytest.raises(MalformedPacketError, match="a packet of 200000000 bytes"):
        client._handle_buffer()
