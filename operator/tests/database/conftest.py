"""Databases of a test; what it started ends with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from database_server import DatabaseServer


@pytest.fixture
def make_server(tmp_path: Path) -> Iterator[Callable[[], DatabaseServer]]:
    servers: list[DatabaseServer] = []

    def make() -> DatabaseServer:
        server = DatabaseServer(tmp_path / f"database-{len(servers)}")
        server.start()
        servers.append(server)
        return server

    yield make
    for server in servers:
        server.close()


@pytest.fixture
def server(make_server: Callable[[], DatabaseServer]) -> DatabaseServer:
    return make_server()
