"""The recordings' database over MongoDB's protocol: MongoDB itself, or FerretDB in the embedded profile.

Only what both have is used: insert, find, update by `_id` ($set, $addToSet), one index per collection. Library errors
are translated: whatever may pass (network, server away, account not there yet) becomes UnavailableError.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from pymongo import UpdateOne
from pymongo.database import Database
from pymongo.errors import BulkWriteError

from robotkube.foundation.database.adapters.connection import translated
from robotkube.robots.recording.core.documents import (
    AUDITS,
    BUCKET_BYTES_MAX,
    INDEX,
    MANIFESTS,
    RECORDINGS,
    SAMPLES,
    SEGMENTS,
    Write,
)

WRITE_BYTES_MAX = 8 * 1024 * 1024
ANSWER_BYTES_MAX = 4 * 1024 * 1024
# An answer of the database has a bound of time, and FerretDB needs 60 ms for a bucket of 512 KiB, whatever is asked of
# it, ten times that on a loaded machine: so each answer has few documents, and few of those that may be large.
_AT_ONCE = {
    SAMPLES: ANSWER_BYTES_MAX // BUCKET_BYTES_MAX, INDEX: 200, SEGMENTS: 200, AUDITS: 50, MANIFESTS: 20,
}  # fmt: skip
# FerretDB holds one of its 100 connections to a database per update until the whole command is answered: more than
# that, by all recorders together, and it waits for itself for ever.
UPDATES_AT_ONCE_MAX = 10
_INDEXED = (SAMPLES, INDEX, SEGMENTS, AUDITS, MANIFESTS)
_WHOLE = (INDEX, SEGMENTS, AUDITS, MANIFESTS)
_WITHOUT_DATA = {
    "recording": 1, "topic": 1, "second": 1, "samples.stamp": 1, "samples.received": 1, "samples.sha256": 1,
}  # fmt: skip
_DUPLICATE_KEY = 11000


class PymongoRecordingStore:
    """Writing access for one recorder."""

    def __init__(self, database: Database[dict[str, Any]]) -> None:
        self._database = database
        self._indexed: set[str] = set()

    def known(self, recording: str) -> Iterable[tuple[str, int, str]]:
        """Topic, stamp, SHA-256 of every stored message of the recording."""
        with translated(f"reading recording {recording}"):
            if self._database[RECORDINGS].find_one({"_id": recording}, {"_id": 1}) is None:
                return  # it is written before all else; not every server finds the rest without reading everything
            fields = {"topic": 1, "samples.stamp": 1, "samples.sha256": 1}
            for bucket in _of(self._database, SAMPLES, recording, fields):
                for sample in bucket["samples"]:
                    yield bucket["topic"], sample["stamp"], sample["sha256"]
            fields = {"topic": 1, "stamp": 1, "sha256": 1}
            for entry in _of(self._database, INDEX, recording, fields):
                yield entry["topic"], entry["stamp"], entry["sha256"]

    def documents(self, recording: str) -> Iterable[tuple[str, Mapping[str, Any]]]:
        """Everything that the database has of the recording; samples without their data."""
        with translated(f"reading recording {recording}"):
            own = self._database[RECORDINGS].find_one({"_id": recording})
            if own is None:
                return  # as above
            yield RECORDINGS, own
            for collection, fields in ((SAMPLES, _WITHOUT_DATA), *((name, None) for name in _WHOLE)):
                for document in _of(self._database, collection, recording, fields):
                    yield collection, document

    def finished(self, volume: str) -> Collection[str]:
        """Paths of the volume's segments whose end is in `segments`."""
        with translated(f"reading the segments of {volume}"):
            entries = self._database[SEGMENTS].find({"volume": volume}, {"segment": 1, "sha256": 1})
            return {entry["segment"] for entry in entries if entry["sha256"]}

    def write(self, writes: Sequence[Write]) -> None:
        """Insert and update in this order; what is there already stays as it is."""
        for (collection, update), group in itertools.groupby(writes, lambda write: (write.collection, write.update)):
            if update:
                self._update(collection, list(group))
            else:
                self._insert(collection, list(group))

    def ping(self) -> None:
        """Return when the database answers a reading command of this account."""
        with translated("ping"):
            self._database[RECORDINGS].find_one({"_id": ""}, {"_id": 1})

    def close(self) -> None:
        """Close the connections."""
        self._database.client.close()

    def _insert(self, collection: str, writes: Sequence[Write]) -> None:
        if collection in _INDEXED and collection not in self._indexed:
            with translated(f"indexing {collection}"):
                self._database[collection].create_index([("recording", 1), ("topic", 1)])
            self._indexed.add(collection)
        for part in _parts(writes):
            documents = [{**write.document, "_id": write.id} for write in part]
            with translated(f"writing {len(documents)} documents to {collection}"):
                try:
                    self._database[collection].insert_many(documents, ordered=False)
                except BulkWriteError as error:
                    faults = (error.details or {}).get("writeErrors", [])
                    if not faults or any(fault.get("code") != _DUPLICATE_KEY for fault in faults):
                        raise

    def _update(self, collection: str, writes: Sequence[Write]) -> None:
        with translated(f"updating {len(writes)} documents of {collection}"):
            changes = [UpdateOne({"_id": write.id}, _change(write)) for write in writes]
            for start in range(0, len(changes), UPDATES_AT_ONCE_MAX):
                self._database[collection].bulk_write(changes[start : start + UPDATES_AT_ONCE_MAX], ordered=True)


def _of(
    database: Database[dict[str, Any]], collection: str, recording: str, fields: Mapping[str, int] | None = None
) -> Iterator[dict[str, Any]]:
    """The documents of a recording in a collection, as many in each answer as fit its bound."""
    return database[collection].find({"recording": recording}, fields, batch_size=_AT_ONCE[collection])


def _change(write: Write) -> dict[str, Any]:
    change: dict[str, Any] = {"$set": dict(write.document)} if write.document else {}
    return {**change, "$addToSet": dict(write.add)} if write.add else change


def _parts(writes: Sequence[Write]) -> Iterator[list[Write]]:
    part: list[Write] = []
    size = 0
    for write in writes:
        if part and size + write.size > WRITE_BYTES_MAX:
            yield part
            part = []
            size = 0
        part.append(write)
        size += write.size
    if part:
        yield part


class PymongoRecordingReader:
    """Reading access to a database of recordings."""

    def __init__(self, database: Database[dict[str, Any]]) -> None:
        self._database = database

    def recordings(self) -> Sequence[Mapping[str, Any]]:
        """The documents of `recordings`, oldest first."""
        with translated("listing recordings"):
            return sorted(self._database[RECORDINGS].find(), key=lambda document: document.get("started", 0))

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The recording's buckets of small messages."""
        with translated(f"reading samples of {recording}"):
            yield from _of(self._database, SAMPLES, recording)

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The recording's index entries of large messages."""
        with translated(f"reading the index of {recording}"):
            yield from _of(self._database, INDEX, recording)

    def segments(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """The recording's finished files."""
        with translated(f"reading the segments of {recording}"):
            return list(_of(self._database, SEGMENTS, recording))

    def audits(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """The recording's audits."""
        with translated(f"reading audits of {recording}"):
            return list(_of(self._database, AUDITS, recording))

    def manifests(self, recording: str) -> Sequence[Mapping[str, Any]]:
        """The recording's manifests and their parts."""
        with translated(f"reading the manifests of {recording}"):
            return list(_of(self._database, MANIFESTS, recording))
