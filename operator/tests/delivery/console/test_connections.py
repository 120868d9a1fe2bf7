"""Clients of the console's server that are slow or mean harm: each takes places and time from itself alone."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest
from starlette.types import Receive, Scope, Send

from robotkube.delivery.console.adapters.web.connections import WebBounds, bounded_connections
from robotkube.delivery.console.adapters.web.server import AsgiServer
from robotkube.errors import InputError
from tests.stages.waiting import until

HERE, THERE = "127.0.0.1", "127.0.0.2"
ASK = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"
LONG = b"GET /long HTTP/1.1\r\nHost: x\r\n\r\n"
LONG_BYTES = 64 * 1024 * 1024
SOON = WebBounds(connections_of_source=3, request_seconds=0.2, stalled_seconds=0.2)


async def answer(scope: Scope, receive: Receive, send: Send) -> None:
    """A short answer, or a long one."""
    body = bytes(LONG_BYTES) if scope["path"] == "/long" else b"ok"
    length = (b"content-length", str(len(body)).encode())
    await send({"type": "http.response.start", "status": 200, "headers": [length]})
    await send({"type": "http.response.body", "body": body})


class Served:
    """A server, and its clients."""

    def __init__(self, bounds: WebBounds, proxies: tuple[str, ...] = ()) -> None:
        self.server = AsgiServer(answer, HERE, 0, proxies, bounds)
        self.server.start()
        self.clients = ExitStack()

    def connect(self, source: str = HERE) -> socket.socket:
        made = socket.create_connection((HERE, self.server.port), timeout=5, source_address=(source, 0))
        return self.clients.enter_context(made)

    def answers(self, source: str = HERE) -> bool:
        """Return whether a new client is answered."""
        client = self.connect(source)
        with suppress(OSError):
            client.sendall(ASK)
        return got(client).startswith(b"HTTP/1.1 200")

    def close(self) -> None:
        self.clients.close()
        self.server.stop()


def got(client: socket.socket) -> bytes:
    """What comes next; empty when the connection is at its end."""
    try:
        return client.recv(4096)
    except ConnectionResetError:
        return b""


@pytest.fixture
def open_servers() -> Iterator[list[Served]]:
    made: list[Served] = []
    yield made
    for one in made:
        one.close()


def test_one_source_has_so_many_connections(open_servers: list[Served], caplog: pytest.LogCaptureFixture) -> None:
    served = Served(WebBounds(connections_of_source=3))
    open_servers.append(served)
    held = [served.connect() for _ in range(3)]
    for client in held:
        client.sendall(ASK)
        assert got(client)
    assert all(got(served.connect()) == b"" for _ in range(20))
    assert served.answers(THERE)
    assert [message for message in caplog.messages if "refused" in message] == [
        "connections refused count=1 last_source=127.0.0.1 reason=it has 3; find out what keeps them open"
    ]
    held[0].close()
    until(served.answers, "its place is another one's")


def test_a_proxy_is_many_people(open_servers: list[Served]) -> None:
    served = Served(WebBounds(connections_of_source=1), ("127.0.0.0/30",))
    open_servers.append(served)
    assert all(served.answers() for _ in range(5))
    with pytest.raises(InputError, match=r"proxies: '10\.0\.0\.1/99' does not appear to be"):
        bounded_connections(SOON, ["10.0.0.1/99"])


@pytest.mark.parametrize(
    "begun",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"GET / HT", id="half a request"),
        pytest.param(ASK + b"GET / HT", id="half of the next one"),
        pytest.param(ASK.replace(b"\r\n\r\n", b"\r\nContent-Length: 9999999\r\n\r\nx"), id="a body without end"),
    ],
)
def test_a_request_that_does_not_come_ends_its_connection(open_servers: list[Served], begun: bytes) -> None:
    served = Served(SOON)
    open_servers.append(served)
    client = served.connect()
    client.sendall(begun)
    while got(client):
        pass


def test_an_answer_that_nobody_takes_ends_its_connection(open_servers: list[Served]) -> None:
    served = Served(SOON)
    open_servers.append(served)
    client = served.connect()
    client.sendall(LONG)
    assert got(client).startswith(b"HTTP/1.1 200")
    until(lambda: not served.server.connections, "it is ended")
    assert served.answers()
