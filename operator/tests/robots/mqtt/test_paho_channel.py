"""The MQTT connection against a real mosquitto with accounts and ACL, on the loopback interface."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.measuring import pods
from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.mqtt.adapters.paho_client import MqttClient
from robotkube.robots.mqtt.core.packets import read_number, write_number
from tests.stages.channel_events import KeptEvents

pytestmark = pytest.mark.processes

WAIT_SECONDS = 30.0
TOPIC = "mqtt/vehicles/vehicle_00/pose"
OPEN: list[PahoChannel] = []
"""The channels that a test has opened."""


@pytest.fixture(autouse=True)
def _closed_channels() -> Iterator[None]:
    """Close what a test has opened: a channel and its client know each other, so only the collector would end them."""
    yield
    while OPEN:
        OPEN.pop().close()


class Peer:
    """A connection and its events."""

    def __init__(self, broker: pods.Broker, account: str, password: str | None = None) -> None:
        self.events = KeptEvents()
        credentials = BrokerAccount("127.0.0.1", broker.port, account, password or pods.password(account))
        self.channel = PahoChannel(lambda: credentials, f"{account}-telemetry", 60, self.events)
        OPEN.append(self.channel)

    def send(self, payload: bytes, retained: bool = False, topic: str = TOPIC) -> int:
        token = self.channel.publish(topic, payload, retained)
        assert token is not None
        return token


def turn_until(condition: Callable[[], object], *peers: Peer) -> None:
    deadline = time.monotonic() + WAIT_SECONDS
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        for peer in peers:
            peer.channel.turn(time.monotonic())
            peer.channel.flush()
        time.sleep(0.005)


def connected(peer: Peer) -> Peer:
    turn_until(lambda: peer.channel.complaint is None, peer)
    return peer


def subscribed(sender: Peer, receiver: Peer) -> None:
    """Returns when the broker has the receiver's subscription, as it reports to the sender; one probe at a time."""
    heard = sender.events.acknowledgements
    while True not in heard.values():
        token = sender.send(b"probe")
        turn_until(lambda token=token: token in heard, sender, receiver)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[pods.Broker]:
    running = pods.Broker(tmp_path, {"vehicle-00": pods.vehicle_rules("vehicle-00"), "cloud-0": pods.CLOUD_RULES})
    running.start()
    yield running
    running.stop()


def test_messages_of_any_size_arrive_in_order_and_are_acknowledged(broker: pods.Broker) -> None:
    vehicle, cloud = connected(Peer(broker, "vehicle-00")), connected(Peer(broker, "cloud-0"))
    cloud.channel.subscribe(["mqtt/vehicles/vehicle_00/#"])
    subscribed(vehicle, cloud)
    payloads = [b"", b"a", bytes(127), bytes(128), bytes(20_000), bytes(320_000), bytes(3_000_000), b"end"]
    tokens = [vehicle.send(payload) for payload in payloads]
    turn_until(lambda: (TOPIC, b"end") in cloud.events.messages, vehicle, cloud)
    turn_until(lambda: vehicle.events.acknowledgements.keys() >= set(tokens), vehicle, cloud)
    messages = [payload for _, payload in cloud.events.messages if payload != b"probe"]
    assert messages == payloads
    assert all(vehicle.events.acknowledgements[token] for token in tokens)


def test_what_nobody_hears_is_reported_and_retained_messages_come_later(broker: pods.Broker) -> None:
    vehicle = connected(Peer(broker, "vehicle-00"))
    volatile, retained = vehicle.send(b"1"), vehicle.send(b"2", retained=True)
    turn_until(lambda: len(vehicle.events.acknowledgements) == 2, vehicle)
    assert vehicle.events.acknowledgements[volatile] is False
    assert retained in vehicle.events.acknowledgements
    cloud = connected(Peer(broker, "cloud-0"))
    cloud.channel.subscribe([TOPIC])
    turn_until(lambda: cloud.events.messages == [(TOPIC, b"2")], cloud)


def test_the_broker_keeps_messages_for_a_client_that_comes_back(broker: pods.Broker) -> None:
    vehicle, cloud = connected(Peer(broker, "vehicle-00")), connected(Peer(broker, "cloud-0"))
    cloud.channel.subscribe([TOPIC])
    subscribed(vehicle, cloud)
    cloud.channel.close()
    tokens = [vehicle.send(payload) for payload in (b"1", b"2", b"3")]
    turn_until(lambda: set(tokens) <= set(vehicle.events.acknowledgements), vehicle)
    assert all(vehicle.events.acknowledgements[token] for token in tokens)
    again = connected(Peer(broker, "cloud-0"))
    assert again.events.sessions == [True]
    turn_until(lambda: (TOPIC, b"3") in again.events.messages, again)  # a probe that was heard may come once more
    assert [payload for _, payload in again.events.messages[-3:]] == [b"1", b"2", b"3"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_connection_is_made_again(broker: pods.Broker, number: int) -> None:
    peer = connected(Peer(broker, "vehicle-00"))
    broker.stop(number)
    turn_until(lambda: peer.events.losses == 1, peer)
    assert "vehicle-00-telemetry" in str(peer.channel.complaint)
    assert peer.channel.publish(TOPIC, b"x", False) is None
    broker.start()
    turn_until(lambda: peer.events.sessions == [False, False], peer)
    assert peer.channel.complaint is None


def test_wrong_accounts_and_foreign_topics_are_refused_in_words(broker: pods.Broker) -> None:
    stranger = Peer(broker, "vehicle-00", "wrong")
    turn_until(lambda: "refuses the connection: Not authorized" in str(stranger.channel.complaint), stranger)
    cloud = connected(Peer(broker, "cloud-0"))
    cloud.send(b"x")
    turn_until(lambda: cloud.events.refusals, cloud)
    assert "the broker refuses a message (reason 0x87" in cloud.events.refusals[0]
    assert "look at its rights, `robotkube agent rights`" in cloud.events.refusals[0]


@pytest.mark.parametrize(
    ("setting", "size", "retained", "words"),
    [
        ("max_packet_size 2000", 2000, False, "at most 2000 are accepted; see the broker's max_packet_size"),
        ("retain_available false", 10, True, "the broker retains no messages; let it"),
        ("message_size_limit 2000", 2001, False, "(reason 0x95 of MQTT 5); look at the broker's limits and log"),
    ],
)
def test_what_a_broker_does_not_accept_costs_no_connection(
    tmp_path: Path, setting: str, size: int, retained: bool, words: str
) -> None:
    broker = pods.Broker(tmp_path, {"vehicle-00": pods.vehicle_rules("vehicle-00")})
    settings = tmp_path / "mosquitto.conf"
    kept = [line for line in settings.read_text().splitlines() if line.split()[:1] != setting.split()[:1]]
    settings.write_text("\n".join([*kept, setting, ""]))
    broker.start()
    try:
        peer = connected(Peer(broker, "vehicle-00"))
        peer.send(bytes(size), retained)
        good = peer.send(b"good")
        turn_until(lambda: good in peer.events.acknowledgements and peer.events.refusals, peer)
    finally:
        broker.stop()
    assert words in peer.events.refusals[0]
    assert peer.events.losses == 0


def test_the_reason_of_a_broker_that_disconnects_is_quoted() -> None:
    reasons: list[str] = []
    client = MqttClient("x", lambda *_: None, lambda *_: None)
    client.on_disconnect = lambda client, userdata, flags, reason, properties: reasons.append(str(reason))
    for packet in (b"\xe0\x01\x95", b"\xe0\x02\x8b\0", b"\xe0\0"):
        client._buffer += packet
        client._handle_buffer()
        client._buffer.clear()
    assert reasons == ["Packet too large", "Server shutting down", "Normal disconnection"]


def test_an_absent_broker_is_a_complaint() -> None:
    account = BrokerAccount("127.0.0.1", 9, "a", "b")
    events = KeptEvents()
    channel = PahoChannel(lambda: account, "a-telemetry", 60, events)
    OPEN.append(channel)
    deadline = time.monotonic() + WAIT_SECONDS
    while "does not answer" not in str(channel.complaint):
        assert time.monotonic() < deadline
        channel.turn(time.monotonic())
        time.sleep(0.01)
    assert events.losses == 0


@given(st.integers(0, 268_435_455))
def test_lengths_are_written_as_they_are_read(length: int) -> None:
    data = bytearray(write_number(length))
    assert read_number(data, 0, len(data)) == (length, len(data))
    assert read_number(data, 0, len(data) - 1) is None


@given(st.lists(st.binary(max_size=300), max_size=6), st.lists(st.integers(1, 400), min_size=1, max_size=20))
def test_messages_are_put_together_from_any_pieces(payloads: list[bytes], cuts: list[int]) -> None:
    got: list[bytes] = []
    client = MqttClient("x", lambda topic, payload, properties: got.append(payload), lambda mid, reason: None)
    for payload in payloads:
        client.send_message("mqtt/topic", payload, False, b"")
    stream = b"".join(packet["packet"] for packet in client._out_packet)
    client._out_packet.clear()
    place, turn = 0, 0
    while place < len(stream):
        size = cuts[turn % len(cuts)]
        client._buffer += stream[place : place + size]
        place, turn = place + size, turn + 1
        assert client._handle_buffer()
    assert got == payloads
    assert len(client._out_packet) == len(payloads)
