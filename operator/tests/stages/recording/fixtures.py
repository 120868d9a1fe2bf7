"""Databases of a test; what it started ends with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.stages.recording.database_server import DatabaseServer


@pytest.fixture
def make_database(tmp_path: Path) -> Iterator[Callable[[], DatabaseServer]]:
    servers: list[DatabaseServer] = []

    def make() -> DatabaseServer:
        database_server = DatabaseServer(tmp_path / f"database-{len(servers)}")
        database_server.start()
        servers.append(database_server)
        return database_server

    yield make
    for database_server in servers:
        database_server.close()


@pytest.fixture
def database_server(make_database: Callable[[], DatabaseServer]) -> DatabaseServer:
    return make_database()
