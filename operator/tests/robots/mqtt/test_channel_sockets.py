"""A closed channel leaves no socket open, whatever it was doing; without a broker, against a plain TCP server."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from robotkube.robots.mqtt.adapters.broker_account import BrokerAccount
from robotkube.robots.mqtt.adapters.paho_channel import PahoChannel
from robotkube.robots.mqtt.adapters.tcp_sockets import SocketBound
from tests.stages.channel_events import KeptEvents
from tests.stages.waiting import until

SECONDS_MAX = 10.0
ACCEPTED = b"\x20\x03\x00\x00\x00"  # CONNACK: success, no session, no properties
MESSAGE = b"\x32\x07\x00\x01a\x00\x07\x00x"  # PUBLISH with QoS 1: topic a, identifier 7, no properties
ACKNOWLEDGED = b"\x40\x02\x00\x07"  # its PUBACK
DISCONNECTED = b"\xe0"  # how a DISCONNECT begins


class Server:
    """Accepts connections, and answers nothing by itself."""

    def __init__(self) -> None:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._socket.settimeout(SECONDS_MAX)
        self._connections: list[socket.socket] = []
        self.account = BrokerAccount("127.0.0.1", self._socket.getsockname()[1], "a", "b")

    def accept(self) -> socket.socket:
        """The next connection."""
        connection, _ = self._socket.accept()
        connection.settimeout(SECONDS_MAX)
        self._connections.append(connection)
        return connection

    def close(self) -> None:
        """Close everything."""
        for one in (self._socket, *self._connections):
            one.close()


@pytest.fixture
def server() -> Iterator[Server]:
    running = Server()
    yield running
    running.close()


def everything(connection: socket.socket) -> bytes:
    """What a connection brings until its end; it must end in time."""
    content = b""
    with contextlib.suppress(ConnectionResetError):
        while data := connection.recv(65536):
            content += data
    return content


def channel_to(account: Any) -> PahoChannel:
    return PahoChannel(account, "a-telemetry", 60, KeptEvents())


def connected(server: Server) -> tuple[PahoChannel, socket.socket]:
    """A channel that is connected, and the server's end of it."""
    channel = channel_to(lambda: server.account)
    channel.turn(0.0)
    connection = server.accept()

    def step() -> bool:
        channel.turn(0.0)
        channel.flush()
        return channel.complaint is None

    until(lambda: step() or channel.socket is not None, "adopted")
    connection.sendall(ACCEPTED)
    until(step, "connected")
    return channel, connection


def test_a_connection_that_was_made_and_not_used_yet_is_closed(server: Server) -> None:
    channel = channel_to(lambda: server.account)
    channel.turn(0.0)
    connection = server.accept()
    attempt = channel._attempt
    assert attempt is not None
    until(lambda: not attempt.running, "connected")
    channel.close()
    assert everything(connection) == b""
    assert channel.socket is None


def test_an_attempt_that_goes_on_after_the_close_leaves_no_connection(server: Server) -> None:
    go_on = threading.Event()

    def account() -> BrokerAccount:
        assert go_on.wait(SECONDS_MAX)
        return server.account

    channel = channel_to(account)
    channel.turn(0.0)
    attempt = channel._attempt
    channel.close()
    go_on.set()
    assert everything(server.accept()) == b""
    assert attempt is not None
    assert attempt.client is None


def test_what_waits_is_sent_with_the_farewell_and_the_socket_is_closed(server: Server) -> None:
    channel, connection = connected(server)
    client = channel._client
    for payload in (b"first", b"second"):
        channel.publish("a", payload, False)
    channel.close()
    assert client is not None
    assert client.socket() is None
    content = everything(connection)
    assert content.index(b"first") < content.index(b"second") < content.rindex(DISCONNECTED)


def test_what_was_acknowledged_is_read_by_a_server_that_writes_first(server: Server) -> None:
    """As a broker does that has more for us when we leave: it would send again what it does not know we have."""
    channel, connection = connected(server)
    client = channel._client
    connection.recv(65536)  # its CONNECT
    connection.sendall(MESSAGE)
    until(lambda: channel.turn(0.0) or channel.wants_write, "acknowledged")
    leaving = threading.Thread(target=channel.close)
    leaving.start()
    until(lambda: select.select([connection], [], [], 0)[0], "the farewell is here")
    for _ in range(3):
        connection.sendall(MESSAGE)
    content = b"".join(iter(lambda: connection.recv(65536), b""))
    assert content.startswith(ACKNOWLEDGED + DISCONNECTED)
    connection.close()
    leaving.join(SECONDS_MAX)
    assert client is not None
    assert client.socket() is None


def test_the_socket_is_closed_although_the_server_reads_nothing(server: Server) -> None:
    channel, connection = connected(server)
    client = channel._client
    while not channel.wants_write:
        channel.publish("a", bytes(1_000_000), False)
        channel.flush()
    channel.close()
    assert client is not None
    assert client.socket() is None
    everything(connection)


def test_a_socket_that_cannot_be_prepared_is_closed(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[socket.socket] = []

    def refuse(bound: SocketBound, connection: socket.socket) -> None:
        made.append(connection)
        raise OSError("the peer is gone")

    monkeypatch.setattr(SocketBound, "opened", refuse)
    channel = channel_to(lambda: server.account)

    def refused() -> bool:
        channel.turn(0.0)
        return "the peer is gone" in str(channel.complaint)

    until(refused, "refused")
    assert [one.fileno() for one in made] == [-1]
    assert everything(server.accept()) == b""
