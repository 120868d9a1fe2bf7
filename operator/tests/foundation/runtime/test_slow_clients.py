"""Clients that are slow or mean harm: each takes places and time from itself alone; health has a port of its own."""

import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from robotkube.foundation.documents.core.json_codec import LEVELS_MAX
from robotkube.foundation.runtime.adapters import webhook_server
from robotkube.foundation.runtime.adapters.bounded_connections import (
    ANSWER_SECONDS_MAX,
    BODY_SECONDS_MAX,
    CONNECTIONS_MAX,
    CONNECTIONS_OF_SOURCE_MAX,
    HEAD_BYTES_MAX,
    HEAD_SECONDS_MAX,
    IDLE_SECONDS_MAX,
    ConnectionBounds,
    ConnectionPlaces,
)
from robotkube.foundation.runtime.adapters.webhook_server import BODY_BYTES_MAX, WebServer
from robotkube.foundation.runtime.core.webhook_deliveries import WebhookDelivery, sign
from tests.stages import http_calls
from tests.stages.attacks import shown
from tests.stages.paths import REPOSITORY
from tests.stages.waiting import until

SECRET = b"shared"
HERE, THERE, ELSEWHERE, FAR = "127.0.0.1", "127.0.0.2", "127.0.0.3", "127.0.0.4"
REQUEST_LINE = b"POST /webhook HTTP/1.1\r\n"
LIVE = b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n"
PIECES_MAX = 200


class Clock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


class Served:
    def __init__(self, metrics: str = "", **bounds: float) -> None:
        self.clock = Clock()
        self.deliveries: list[WebhookDelivery] = []
        self.server = WebServer(
            *(HERE, 0, list, lambda: metrics, SECRET, self.deliveries.append),
            pages={"/plans": dict},
            health_port=0,
            bounds=ConnectionBounds(**bounds),  # type: ignore[arg-type]
            monotonic=self.clock,
        )
        self.server.start()
        self.clients = ExitStack()

    def connect(self, source: str = HERE, port: str = "port") -> socket.socket:
        address = (HERE, self.server.ports[port])
        connection = socket.create_connection(address, timeout=5, source_address=(source, 0))
        return self.clients.enter_context(connection)

    def hold(self, source: str, count: int) -> list[socket.socket]:
        """Connections that begin a request and wait."""
        held = [self.connect(source) for _ in range(count)]
        for connection in held:
            connection.sendall(LIVE[:5])
        return held

    def answer(self, source: str = HERE, request: bytes = LIVE, port: str = "port") -> bytes:
        """The beginning of the answer to one request, whose connection is closed then; empty when it was dropped."""
        try:
            with self.connect(source, port) as connection:
                connection.sendall(request)
                connection.shutdown(socket.SHUT_WR)
                answer = connection.recv(4096)
                while connection.recv(4096):
                    continue
                return answer[:12]
        except TimeoutError:
            raise
        except OSError:  # reset, or ended before this end was
            return b""

    def stop(self) -> None:
        self.clients.close()
        self.server.stop()


@pytest.fixture
def start(caplog: pytest.LogCaptureFixture) -> Iterator[Callable[..., Served]]:
    with ExitStack() as running:

        def served(**arguments: Any) -> Served:
            server = Served(**arguments)
            running.callback(server.stop)
            return server

        yield served
    assert [record.message for record in caplog.records if record.exc_info] == []


def signed_delivery() -> bytes:
    head = f"Host: x\r\nX-Gitea-Event: push\r\nX-Gitea-Signature: {sign(b'{}', SECRET)}\r\nContent-Length: 2\r\n\r\n"
    return REQUEST_LINE + head.encode() + b"{}"


def ended(connection: socket.socket) -> bool:
    """Return whether the server has ended it; reads what is there."""
    readable, _, _ = select.select([connection], [], [], 0)
    try:
        return bool(readable) and connection.recv(4096) == b""
    except ConnectionError:
        return True


def trickle(served: Served, connection: socket.socket, piece: bytes) -> bytes:
    """Send a piece each second of the server's clock until the server answers or ends; the answer."""
    answer = b""
    for _ in range(PIECES_MAX):
        readable, _, _ = select.select([connection], [], [], 0.01)
        try:
            if not readable:
                connection.sendall(piece)
            elif part := connection.recv(4096):
                answer += part
            else:
                return answer
        except ConnectionError:
            return answer
        served.clock.seconds += 1
    raise AssertionError(f"served for {served.clock.seconds} s")


def test_sixty_slow_connections_of_one_source_keep_nobody_else_out(start: Callable[..., Served]) -> None:
    served = start()
    slow = [served.connect(THERE) for _ in range(60)]
    for connection in slow:
        try:
            connection.sendall(REQUEST_LINE)
        except ConnectionError:  # refused
            continue
    for _ in range(CONNECTIONS_OF_SOURCE_MAX):
        assert served.answer(HERE, signed_delivery()) == b"HTTP/1.1 204"
    assert served.answer(HERE, LIVE) == b"HTTP/1.1 200"
    for path in ("/livez", "/readyz", "/metrics"):
        assert http_calls.get(f"http://{HERE}:{served.server.ports['health_port']}{path}").status_code == 200


def test_probes_are_answered_while_their_own_source_has_all_its_places(start: Callable[..., Served]) -> None:
    served = start()
    served.hold(HERE, CONNECTIONS_OF_SOURCE_MAX)
    assert served.answer() == b"", "beyond its bound"
    for _ in range(CONNECTIONS_MAX):
        assert served.answer(port="health_port") == b"HTTP/1.1 200"


def test_the_bounds_of_a_source_leave_places_for_others() -> None:
    assert CONNECTIONS_OF_SOURCE_MAX < CONNECTIONS_MAX


def test_a_source_beyond_its_bound_ends_its_own_oldest_connection(start: Callable[..., Served]) -> None:
    served = start(connections=6, connections_of_source=3)
    other = served.hold(ELSEWHERE, 2)
    own = served.hold(THERE, 3)
    assert served.answer(THERE) == b""
    until(lambda: ended(own[0]), "the oldest is ended")
    until(lambda: served.answer(THERE) == b"HTTP/1.1 200", "the place of the oldest")
    assert not any(map(ended, other))


def test_a_source_with_few_is_not_kept_out_by_those_with_many(start: Callable[..., Served]) -> None:
    served = start(connections=6, connections_of_source=3)
    held = {source: served.hold(source, 3) for source in (THERE, ELSEWHERE)}
    until(lambda: served.answer(HERE) == b"HTTP/1.1 200", "a place")
    assert any(ended(connections[0]) for connections in held.values())


def test_many_sources_with_one_connection_each_keep_theirs() -> None:
    """Nobody has more than the one that comes: it is refused, and no other is ended."""
    places = ConnectionPlaces(ConnectionBounds(connections=2, connections_of_source=2), Clock())
    pairs = [socket.socketpair() for _ in range(3)]
    served, clients = zip(*pairs, strict=True)
    assert [places.enter(served[i], source) for i, source in enumerate((HERE, THERE, FAR))] == [True, True, False]
    assert not any(map(ended, clients))
    places.leave(served[0], HERE)
    places.leave(served[2], FAR)  # it had none
    assert places.enter(served[2], FAR)
    for end in (*served, *clients):
        end.close()


def test_refusals_are_logged_once_in_a_while(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    places = ConnectionPlaces(ConnectionBounds(connections=2, connections_of_source=1), clock)
    pairs = [socket.socketpair() for _ in range(2)]
    places.enter(pairs[0][0], HERE)
    for _ in range(100):
        assert not places.enter(pairs[1][0], HERE)
    clock.seconds += 60
    assert not places.enter(pairs[1][0], HERE)
    assert [message.partition(" reason=")[0] for message in caplog.messages] == [
        "connections refused count=1 last_source=127.0.0.1",
        "connections refused count=100 last_source=127.0.0.1",
    ]
    shown("gate", caplog.text, "slow-connections")
    for pair in pairs:
        for end in pair:
            end.close()


@pytest.mark.parametrize("begin", [b"", REQUEST_LINE, REQUEST_LINE + b"Host: x\r\n"])
def test_headers_that_come_byte_by_byte_are_ended(start: Callable[..., Served], begin: bytes) -> None:
    served = start()
    connection = served.connect()
    connection.sendall(begin)
    answer = trickle(served, connection, b"x")
    assert served.clock.seconds >= HEAD_SECONDS_MAX
    if begin:
        assert answer.startswith(b"HTTP/1.1 408")
        assert b"did not come within 10 s" in answer
    else:
        assert answer == b""


def test_headers_of_a_later_request_are_ended_too(start: Callable[..., Served]) -> None:
    served = start()
    connection = served.connect()
    connection.sendall(LIVE)
    assert connection.recv(4096).startswith(b"HTTP/1.1 200")
    connection.sendall(REQUEST_LINE)
    assert b"HTTP/1.1 408" in trickle(served, connection, b"x")


def test_a_body_that_comes_byte_by_byte_is_ended(start: Callable[..., Served]) -> None:
    served = start()
    connection = served.connect()
    connection.sendall(REQUEST_LINE + b"Host: x\r\nContent-Length: 1000\r\n\r\n")
    answer = trickle(served, connection, b"{")
    assert answer.startswith(b"HTTP/1.1 408")
    assert served.deliveries == []


def test_a_client_that_sends_nothing_is_ended(start: Callable[..., Served]) -> None:
    served = start(head_seconds=0.05)
    connection = served.connect()
    assert connection.recv(10) == b""


def test_an_idle_connection_is_ended(start: Callable[..., Served]) -> None:
    served = start(idle_seconds=0.05)
    connection = served.connect()
    connection.sendall(LIVE)
    while connection.recv(4096):  # within the 5 s of this connection
        continue


def test_a_client_that_does_not_read_its_answer_is_ended(start: Callable[..., Served]) -> None:
    served = start(metrics="x" * 1_000_000, answer_seconds=0.05)
    connection = served.connect()
    connection.settimeout(0.1)

    def broken() -> bool:
        try:
            connection.send(LIVE.replace(b"livez", b"metrics"))
        except TimeoutError:
            return False
        except ConnectionError:
            return True
        return False

    until(broken, "ended by the server")


def test_headers_that_are_too_long_are_refused(start: Callable[..., Served]) -> None:
    served = start()
    connection = served.connect()
    connection.sendall(REQUEST_LINE)
    line = b"x: " + b"y" * 8000 + b"\r\n"
    try:
        for _ in range(2 * HEAD_BYTES_MAX // len(line)):
            connection.sendall(line)
        assert connection.recv(12) == b"HTTP/1.1 431"
    except ConnectionError:  # closed before all of it was sent
        return


def test_the_health_port_answers_nothing_else(start: Callable[..., Served]) -> None:
    served = start()
    assert served.answer(HERE, signed_delivery(), "health_port") == b"HTTP/1.1 404"
    assert served.answer(HERE, LIVE.replace(b"livez", b"plans"), "health_port") == b"HTTP/1.1 404"
    assert served.answer(HERE, LIVE.replace(b"livez", b"plans")) == b"HTTP/1.1 200"
    assert served.deliveries == []


def test_a_process_whose_other_port_has_stopped_is_not_live(start: Callable[..., Served]) -> None:
    served = start()
    served.server._servers["port"].stop()
    answer = http_calls.get(f"http://{HERE}:{served.server.ports['health_port']}/livez")
    assert (answer.status_code, "has stopped" in answer.text) == (503, True)


def test_without_a_health_port_there_is_one_port() -> None:
    server = WebServer(HERE, 0, list, str)
    server.start()
    assert list(server.ports) == ["port"]
    assert http_calls.get(f"http://{HERE}:{server.port}/readyz").status_code == 200
    server.stop()


def test_a_server_that_waits_for_a_connection_ends_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhook_server, "POLL_SECONDS", 600.0)  # so that nothing else ends the wait
    server = WebServer(HERE, 0, list, str, health_port=0)
    server.start()
    assert http_calls.get(f"http://{HERE}:{server.port}/livez").status_code == 200
    ending = threading.Thread(target=server.stop, daemon=True)
    ending.start()
    until(lambda: not ending.is_alive(), "the end of both ports")


def test_half_a_request_is_none(start: Callable[..., Served], caplog: pytest.LogCaptureFixture) -> None:
    served = start()
    assert served.answer(request=REQUEST_LINE + b"Host: x\r\n") == b""
    assert served.answer(request=signed_delivery()[:-1]) == b""
    assert served.deliveries == []
    assert caplog.messages == []


def test_the_page_of_settings_names_the_bounds() -> None:
    text = (REPOSITORY / "docs/reference/settings.md").read_text()
    for words in (
        f"| {CONNECTIONS_OF_SOURCE_MAX} connections of one source address |",
        f"| {CONNECTIONS_MAX} connections of all |",
        f"| {HEAD_SECONDS_MAX:.0f} s for request line and headers together, {HEAD_BYTES_MAX >> 10} KiB |",
        f"| {BODY_SECONDS_MAX:.0f} s for the body, {BODY_BYTES_MAX >> 20} MiB |",
        f"| {IDLE_SECONDS_MAX:.0f} s between two requests, {ANSWER_SECONDS_MAX:.0f} s to read an answer |",
        f"| {LEVELS_MAX} levels of lists and objects in a JSON body |",
    ):
        assert words in text
