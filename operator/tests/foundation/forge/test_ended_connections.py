"""Git from a server that ends connections, as a forge does whose port passes to another process."""

from __future__ import annotations

import socket
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from robotkube.errors import UnavailableError
from robotkube.foundation.forge.adapters.git import GitClone
from scenarios.runner.platform.access import Endpoint
from scenarios.runner.platform.deployment import Deployment
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


class Serving(BaseHTTPRequestHandler):
    """Git's own answers for the repository of its server, by connections that are kept."""

    protocol_version = "HTTP/1.1"
    server: GitServer

    def do_GET(self) -> None:
        self._answer(b"001e# service=git-upload-pack\n0000", "--advertise-refs", given=b"")

    def do_POST(self) -> None:
        self._answer(b"", given=self.rfile.read(int(self.headers["Content-Length"])))

    def _answer(self, before: bytes, *options: str, given: bytes) -> None:
        self.server.connections.add(self.connection)
        command = ["git", "upload-pack", "--stateless-rpc", *options, self.server.folder]
        text = before + subprocess.run(command, input=given, check=True, capture_output=True).stdout
        self.send_response(200)
        kind = "advertisement" if options else "result"
        self.send_header("Content-Type", f"application/x-git-upload-pack-{kind}")
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - its name in the library
        """Nothing: the output belongs to the test."""


class GitServer(ThreadingHTTPServer):
    """A forge with one repository."""

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), Serving)
        self.folder = str(folder)
        self.connections: set[socket.socket] = set()

    def end_connections(self) -> None:
        """As the process does that ends; the next one answers at the same port."""
        for connection in self.connections:
            with suppress(OSError):  # the other side has ended it
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                connection.shutdown(socket.SHUT_RDWR)
        self.connections.clear()


def test_a_run_reads_from_a_forge_that_began_anew(tmp_path: Path) -> None:
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run([*git, "init", "--quiet", "--initial-branch=main"], check=True)
    with GitServer(tmp_path) as forge, Deployment(Endpoint("localhost", forge.server_port), "a", "word") as person:
        thread = threading.Thread(target=forge.serve_forever, args=(0.01,))
        thread.start()
        try:
            for number in range(3):
                subprocess.run([*git, "commit", "--quiet", "--allow-empty", f"--message={number}"], check=True)
                assert person.message(person.fetch()).strip() == str(number)
                forge.end_connections()
        finally:
            forge.shutdown()
            thread.join(WAIT_SECONDS_MAX)
