"""Much at once on the real database: writers do not wait for each other for ever, and every answer stays small."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import pytest
from pymongo import monitoring

from robotkube.robots.recording.adapters.mongodb import (
    ANSWER_BYTES_MAX,
    INDEX,
    PymongoRecordingReader,
    PymongoRecordingStore,
)
from robotkube.robots.recording.core.documents import AUDITS, SAMPLES, Received, Write, bucket_documents

pytestmark = pytest.mark.toolchain

RECORDERS, ENTRIES = 4, 150
SECONDS_MAX = 60.0
BUCKETS = 30
MESSAGE_BYTES = 100_000


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


class Answers(monitoring.CommandListener):
    """The bytes of samples of each answer."""

    def __init__(self) -> None:
        self.sizes: list[int] = []

    def started(self, event: monitoring.CommandStartedEvent) -> None:
        pass

    def failed(self, event: monitoring.CommandFailedEvent) -> None:
        pass

    def succeeded(self, event: monitoring.CommandSucceededEvent) -> None:
        cursor = event.reply.get("cursor", {})
        batch: Iterable[Any] = [*cursor.get("firstBatch", ()), *cursor.get("nextBatch", ())]
        self.sizes.append(sum(len(sample.get("data", b"")) for one in batch for sample in one.get("samples", ())))


def test_no_answer_about_large_buckets_is_large(database_server: Any) -> None:
    """The time of an answer is bounded, and grows with what the database has to read for it."""
    answers = Answers()
    database = database_server.client(event_listeners=[answers])["recordings_cloud_0"]
    store = PymongoRecordingStore(database)
    for second in range(BUCKETS):
        stamps = [second * 10**9 + number for number in range(5)]
        messages = [Received("/p", stamp, stamp, f"{stamp:064x}", bytes(MESSAGE_BYTES)) for stamp in stamps]
        buckets = bucket_documents("task-1", messages)
        store.write([Write(SAMPLES, bucket["_id"], bucket, size=5 * MESSAGE_BYTES) for bucket in buckets])
    answers.sizes.clear()
    assert len(list(PymongoRecordingReader(database).buckets("task-1"))) == BUCKETS
    assert sum(answers.sizes) == BUCKETS * 5 * MESSAGE_BYTES
    assert max(answers.sizes) <= ANSWER_BYTES_MAX


@pytest.mark.parametrize("collection", [SAMPLES, INDEX, AUDITS])
def test_what_is_asked_about_a_recording_reads_no_other_ones(database_server: Any, collection: str) -> None:
    """The first answer about the last recording came after the documents of all before it had been read."""
    database = database_server.client()["recordings_cloud_0"]
    PymongoRecordingStore(database).write([Write(collection, "1", {"recording": "task-1"})])
    plan = database[collection].find({"recording": "task-1"}).explain()["queryPlanner"]["Plan"]
    assert not [line for line in plan if "SCAN" in line]
    assert [line for line in plan if "USING INDEX" in line]


def test_a_string_in_an_indexed_field_is_found_as_without_index(database_server: Any) -> None:
    things = database_server.client()["recordings_cloud_0"]["things"]
    values = ["x", ["x", "y"], "y", 5, None, {"x": "x"}, '"x" \\ é', "[x", []]
    documents = [{"_id": number, "recording": value} for number, value in enumerate(values)]
    things.insert_many([*documents, {"_id": len(values)}])
    asked = ["x", "y", '"x" \\ é', "[x", "[", "", ["x", "y"], 5, {"$gt": "x"}]

    def answers() -> list[list[int]]:
        return [sorted(one["_id"] for one in things.find({"recording": value})) for value in asked]

    before = answers()
    things.create_index([("recording", 1), ("topic", 1)])
    assert answers() == before
    assert before[0] == [0, 1]
