"""Many updates at once, by several recorders, on the real database: none waits for the others for ever."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from robotkube.robots.recording.adapters.mongodb import INDEX, PymongoRecordingStore
from robotkube.robots.recording.core.documents import Write

pytestmark = pytest.mark.toolchain

RECORDERS, ENTRIES = 4, 150
SECONDS_MAX = 60.0


def test_recorders_that_write_much_at_once_do_not_stop_the_database(database_server: Any) -> None:
    database = database_server.client()["recordings_cloud_0"]

    def record(number: int) -> None:
        store = PymongoRecordingStore(database)
        names = [f"{number}/{entry}" for entry in range(ENTRIES)]
        store.write([Write(INDEX, name, {"recording": str(number), "stored": None}) for name in names])
        store.write([Write(INDEX, name, {"stored": 1}, update=True) for name in names])

    recorders = [threading.Thread(target=record, args=(number,), daemon=True) for number in range(RECORDERS)]
    for recorder in recorders:
        recorder.start()
    for recorder in recorders:
        recorder.join(SECONDS_MAX / RECORDERS)
    assert not any(recorder.is_alive() for recorder in recorders)
    assert database[INDEX].count_documents({"stored": 1}) == RECORDERS * ENTRIES
