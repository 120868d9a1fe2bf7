"""Git from a server that ends connections, as a forge does whose port passes to another process."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.forge.adapters.git import GitClone
from scenarios.runner.access import Endpoint
from scenarios.runner.deployment import Deployment
from scenarios.runner.waiting import RunError
from tests.stages.waiting import WAIT_SECONDS_MAX

ANSWER = b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
CONNECTIONS_MAX = 10
RESET = struct.pack("ii", 1, 0)


@contextmanager
def server(ended: int) -> Iterator[tuple[str, list[bool]]]:
    """One that resets so many connections and then says that there is no such repository; which it has answered."""
    answered: list[bool] = []

    def serve() -> None:
        for _ in range(CONNECTIONS_MAX):
            connection, _ = listening.accept()
            connection.settimeout(WAIT_SECONDS_MAX)
            with connection:
                if connection.recv(4096) == b"":
                    return
                answered.append(len(answered) >= ended)
                if answered[-1]:
                    connection.sendall(ANSWER)
                else:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(WAIT_SECONDS_MAX)
        port = listening.getsockname()[1]
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"http://localhost:{port}", answered
        finally:
            socket.create_connection(("127.0.0.1", port)).close()
            thread.join(WAIT_SECONDS_MAX)
            assert not thread.is_alive()


@pytest.mark.parametrize("ended", [0, 1, 2])
def test_what_is_fetched_is_asked_for_again(ended: int, tmp_path: Path) -> None:
    with server(ended) as (url, answered):
        clone = GitClone(url, "robotkube/catalogue", "gate", "word", tmp_path / "clone")
        with pytest.raises(UnavailableError, match="404"):
            clone.fetch()
    assert answered == [*[False] * ended, True]


def test_who_ends_every_connection_is_away(tmp_path: Path) -> None:
    with server(CONNECTIONS_MAX) as (url, answered):
        clone = GitClone(url, "robotkube/catalogue", "gate", "word", tmp_path / "clone")
        with pytest.raises(UnavailableError, match=r"fetch: (.*reset by peer|unexpected EOF)"):
            clone.fetch()
    assert answered == [False] * 3


@pytest.mark.parametrize("read", [Deployment.fetch, lambda forge: forge.pull_request(1)])
def test_a_run_of_a_scenario_asks_again_as_well(read: Callable[[Deployment], object]) -> None:
    with server(2) as (url, answered):
        forge = Endpoint("localhost", int(url.rpartition(":")[2]))
        with Deployment(forge, "reviewer", "word") as person, pytest.raises(RunError, match="404"):
            read(person)
    assert answered == [False, False, True]
