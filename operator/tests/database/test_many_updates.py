"""Many updates at once, by several recorders, on the real database: none waits for the others for ever."""

from __future__ import annotations

import threading
from typing import Any

from robotkube.adapters.mongodb_pymongo import INDEX, PymongoRecordingStore
from robotkube.domain.recordings import Write

RECORDERS, ENTRIES = 4, 150
SECONDS_MAX = 60.0


def test_recorders_that_write_much_at_once_do_not_stop_the_database(server: Any) -> None:
    database = server.client()["recordings_cloud_0"]

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
