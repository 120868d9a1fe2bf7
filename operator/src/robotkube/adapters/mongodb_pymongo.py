"""The recordings' database over MongoDB's protocol: MongoDB itself, or FerretDB in the embedded profile.

Only what both have is used: insert, find, update by `_id`, one index per collection. Library errors are translated:
whatever may pass (network, server away, account not there yet) becomes UnavailableError.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bson
from bson.errors import BSONError
from pymongo import MongoClient, UpdateOne
from pymongo.database import Database
from pymongo.errors import BulkWriteError, DuplicateKeyError, PyMongoError

from robotkube.domain.errors import DocumentError, UnavailableError
from robotkube.domain.recordings import Write

RECORDINGS, SAMPLES, SEGMENTS = "recordings", "samples", "segments_index"
ANSWER_SECONDS_MAX = 5.0
WRITE_BYTES_MAX = 8 * 1024 * 1024
# FerretDB holds one of its 100 connections to a database per update until the whole command is answered: more than
# that, by all recorders together, and it waits for itself for ever.
UPDATES_AT_ONCE_MAX = 10
_DUPLICATE_KEY = 11000
_ACCOUNT_KEYS = ("username", "password", "host", "port", "database", "authenticationDatabase")


@dataclass(frozen=True)
class Account:
    """Where the database is and with which account. `authentication_database`: where the account is known."""

    host: str
    port: int
    database: str
    username: str
    password: str
    authentication_database: str


def read_account(folder: Path) -> Account:
    """Read the mounted Secret `database-account`; DocumentError names the missing or wrong file."""
    values, problems = {}, []
    for key in _ACCOUNT_KEYS:
        try:
            values[key] = (folder / key).read_text().strip()
        except OSError as error:
            problems.append(f"{key}: {error.strerror}; is the Secret mounted there?")
    if not problems and not values["port"].isdigit():
        problems.append("port: must be a number")
    if problems:
        raise DocumentError(str(folder), problems)
    return Account(
        host=values["host"],
        port=int(values["port"]),
        database=values["database"],
        username=values["username"],
        password=values["password"],
        authentication_database=values["authenticationDatabase"],
    )


@contextmanager
def _translated(doing: str) -> Iterator[None]:
    try:
        yield
    except PyMongoError as error:
        text = " ".join(str(error).partition(", Topology Description")[0].split())
        raise UnavailableError(f"database, {doing}: {text[:500]}") from error


def connect(account: Account, answer_seconds_max: float = ANSWER_SECONDS_MAX) -> Database[dict[str, Any]]:
    """The account's database; nothing is sent yet."""
    client: MongoClient[dict[str, Any]] = MongoClient(
        account.host,
        account.port,
        username=account.username,
        password=account.password,
        authSource=account.authentication_database,
        appname="robotkube",
        serverSelectionTimeoutMS=int(answer_seconds_max * 1000),
        connectTimeoutMS=int(answer_seconds_max * 1000),
        socketTimeoutMS=int(answer_seconds_max * 1000),
        maxPoolSize=2,
        retryWrites=False,  # every write may be done twice anyway
        journal=True,  # acknowledged means on the disk
    )
    return client[account.database]


class PymongoRecordingStore:
    """Writing access for one recorder."""

    def __init__(self, database: Database[dict[str, Any]]) -> None:
        self._database = database

    def begin(self, recording: str, document: Mapping[str, Any], volume: str) -> None:
        """Make the recording's document; take an existing one up again: not ended, `volume` among its volumes."""
        with _translated(f"beginning recording {recording}"):
            collection = self._database[RECORDINGS]
            try:
                collection.insert_one({**document, "_id": recording, "volumes": [volume], "ended": None})
            except DuplicateKeyError:
                found = collection.find_one({"_id": recording}) or {}
                volumes = list(dict.fromkeys([*found.get("volumes", []), volume]))
                collection.update_one({"_id": recording}, {"$set": {"volumes": volumes, "ended": None}})
            for name in (SAMPLES, SEGMENTS):
                self._database[name].create_index([("recording", 1), ("topic", 1)])

    def known(self, recording: str) -> Iterable[tuple[str, int, str]]:
        """Topic, stamp, SHA-256 of every stored message of the recording."""
        with _translated(f"reading recording {recording}"):
            fields = {"topic": 1, "samples.stamp": 1, "samples.sha256": 1}
            for bucket in self._database[SAMPLES].find({"recording": recording}, fields):
                for sample in bucket["samples"]:
                    yield bucket["topic"], sample["stamp"], sample["sha256"]
            fields = {"topic": 1, "stamp": 1, "sha256": 1}
            for entry in self._database[SEGMENTS].find({"recording": recording}, fields):
                yield entry["topic"], entry["stamp"], entry["sha256"]

    def write(self, writes: Sequence[Write]) -> None:
        """Insert and update, in this order; what is there already stays as it is."""
        for collection in dict.fromkeys(write.collection for write in writes):
            mine = [write for write in writes if write.collection == collection]
            self._insert(collection, [write for write in mine if not write.update])
            self._update(collection, [write for write in mine if write.update])

    def ping(self) -> None:
        """Returns when the database answers a reading command of this account."""
        with _translated("ping"):
            self._database[RECORDINGS].find_one({"_id": ""}, {"_id": 1})

    def close(self) -> None:
        """Close the connections."""
        self._database.client.close()

    def _insert(self, collection: str, writes: Sequence[Write]) -> None:
        for part in _parts(writes):
            documents = [{**write.document, "_id": write.id} for write in part]
            with _translated(f"writing {len(documents)} documents to {collection}"):
                try:
                    self._database[collection].insert_many(documents, ordered=False)
                except BulkWriteError as error:
                    faults = (error.details or {}).get("writeErrors", [])
                    if not faults or any(fault.get("code") != _DUPLICATE_KEY for fault in faults):
                        raise

    def _update(self, collection: str, writes: Sequence[Write]) -> None:
        if writes:
            with _translated(f"updating {len(writes)} documents of {collection}"):
                changes = [UpdateOne({"_id": write.id}, {"$set": dict(write.document)}) for write in writes]
                for start in range(0, len(changes), UPDATES_AT_ONCE_MAX):
                    self._database[collection].bulk_write(changes[start : start + UPDATES_AT_ONCE_MAX], ordered=False)


def _parts(writes: Sequence[Write]) -> Iterator[list[Write]]:
    part: list[Write] = []
    size = 0
    for write in writes:
        if part and size + write.size > WRITE_BYTES_MAX:
            yield part
            part, size = [], 0
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
        with _translated("listing recordings"):
            return sorted(self._database[RECORDINGS].find(), key=lambda document: document.get("started", 0))

    def buckets(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The recording's buckets of small messages."""
        with _translated(f"reading samples of {recording}"):
            yield from self._database[SAMPLES].find({"recording": recording}, batch_size=100)

    def index(self, recording: str) -> Iterable[Mapping[str, Any]]:
        """The recording's index entries of large messages."""
        with _translated(f"reading the index of {recording}"):
            yield from self._database[SEGMENTS].find({"recording": recording}, batch_size=1000)


class PymongoCollections:
    """A whole database, whatever is in it: for who looks at what others write."""

    def __init__(self, database: Database[dict[str, Any]]) -> None:
        self._database = database

    def counts(self) -> dict[str, int]:
        """Collection -> number of its documents; those of the server itself are left out."""
        with _translated("counting documents"):
            names = [name for name in self._database.list_collection_names() if not name.startswith("system.")]
            return {name: self._database[name].count_documents({}) for name in names}

    def put(self, collection: str) -> None:
        """Write a document without content."""
        with _translated(f"writing to {collection}"):
            self._database[collection].insert_one({})

    def clear(self) -> None:
        """Take all collections away."""
        with _translated("clearing"):
            for name in self.counts():
                self._database.drop_collection(name)


class BsonSpool:
    """Writes that the database has not taken, as BSON files `spool/<ns>-<recording>.bson` on the claim."""

    def __init__(self, root: Path, clock_ns: Callable[[], int]) -> None:
        self._folder, self._clock_ns = root / "spool", clock_ns

    def put(self, recording: str, writes: Sequence[Write]) -> str:
        """Keep them in a new file that appears only when it is complete and on the disk."""
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"{self._clock_ns():020d}-{recording.replace('/', '_')}.bson"
        unfinished = path.with_suffix(".part")
        with unfinished.open("wb") as file:
            for write in writes:
                file.write(bson.encode(_record(write)))
            file.flush()
            os.fsync(file.fileno())
        unfinished.rename(path)
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
        return path.name

    def batches(self) -> Sequence[str]:
        """Names of the files, oldest first."""
        return sorted(path.name for path in self._folder.glob("*.bson"))

    def read(self, batch: str) -> Sequence[Write]:
        """The writes of one file; DocumentError when it is damaged."""
        try:
            with (self._folder / batch).open("rb") as file:
                return [Write(**values) for values in bson.decode_file_iter(file)]
        except (BSONError, TypeError) as error:
            raise DocumentError(str(self._folder / batch), [f"is damaged: {error}"]) from error

    def remove(self, batch: str) -> None:
        """Delete the file."""
        (self._folder / batch).unlink(missing_ok=True)


def _record(write: Write) -> dict[str, Any]:
    return {
        "collection": write.collection,
        "id": write.id,
        "document": dict(write.document),
        "update": write.update,
        "size": write.size,
    }
