"""The spool: writes that the database has not acknowledged, as BSON files `spool/<ns>-<number>-<owner>.bson`."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import bson
from bson.errors import BSONError

from robotkube.errors import DocumentError
from robotkube.robots.recording.core.documents import COLLECTIONS, Write, messages_of
from robotkube.robots.recording.ports import NO_SPACE, Batch

_GIVEN_UP = "-given-up"


class BsonSpool:
    """The spool of a volume claim. `owner` is the part of the names that says who wrote a file."""

    def __init__(self, root: Path, owner: str, clock_ns: Callable[[], int]) -> None:
        self._folder = root / "spool"
        self._owner = owner.replace("/", "_")
        self._clock_ns = clock_ns
        self._number = 0
        for path in self._folder.glob(f"*-{self._owner}.part"):
            path.unlink(missing_ok=True)  # of an earlier process that was killed while it wrote

    def put(self, writes: Sequence[Write]) -> str:
        """Keep them in a new file that appears only when it is complete and on the disk."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._number += 1
        path = self._folder / f"{self._clock_ns():020d}-{self._number:06d}-{self._owner}.bson"
        self._write(path, writes)
        return path.name

    def batches(self) -> Sequence[Batch]:
        """The files, oldest first."""
        batches = []
        for path in sorted(self._folder.glob("*.bson")):
            with suppress(FileNotFoundError):
                batches.append(Batch(path.name, path.stat().st_size, path.stem.endswith(_GIVEN_UP)))
        return batches

    def read(self, batch: str) -> Sequence[Write]:
        """The writes of one file; DocumentError: it is damaged or gone, or cannot be read while the volume works."""
        path = self._folder / batch
        try:
            with path.open("rb") as file:
                return [_checked(Write(**values)) for values in bson.decode_file_iter(file)]
        except FileNotFoundError as error:
            raise DocumentError(str(path), ["is gone: another recorder has brought it in"]) from error
        except OSError as error:
            if error.errno != errno.EIO or not self._serves():
                raise
            raise DocumentError(str(path), [f"cannot be read ({error.strerror}), though the volume works"]) from error
        except (BSONError, TypeError, KeyError, AttributeError) as error:
            raise DocumentError(str(path), [f"is damaged: {error}"]) from error

    def give_up(self, batch: str, writes: Sequence[Write]) -> None:
        """Put these writes in the file's place; on a full disk over its begin, where no second file fits."""
        path = self._folder / batch
        if not path.exists():
            return  # another recorder has brought it in
        try:
            self._write(path, writes)
        except OSError as error:
            if error.errno not in NO_SPACE:
                raise
            records = [bson.encode(_record(write)) for write in writes]
            with path.open("r+b") as file:
                _store(file, records)
        path.rename(path.with_name(f"{path.stem}{_GIVEN_UP}.bson"))

    def remove(self, batch: str) -> None:
        """Delete the file."""
        (self._folder / batch).unlink(missing_ok=True)

    def _write(self, path: Path, writes: Sequence[Write]) -> None:
        """Write a file that appears, or replaces another, when it is whole and on the disk."""
        unfinished = self._unfinished()
        try:
            with unfinished.open("wb") as file:
                _store(file, (bson.encode(_record(write)) for write in writes))
            unfinished.rename(path)
        except OSError:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
            raise
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _serves(self) -> bool:
        """Return whether the volume accepts a file, or says that it is full."""
        probe = self._unfinished()
        try:
            with probe.open("wb") as file:
                _store(file, [b"?"])
        except OSError as error:
            return error.errno in NO_SPACE
        finally:
            with suppress(OSError):
                probe.unlink(missing_ok=True)
        return True

    def _unfinished(self) -> Path:
        return self._folder / f"{self._clock_ns():020d}-{self._owner}.part"


def _store(file: BinaryIO, parts: Iterable[bytes]) -> None:
    """Write these parts and nothing behind them, and synchronise."""
    file.writelines(parts)
    file.truncate()
    file.flush()
    os.fsync(file.fileno())


def _checked(write: Write) -> Write:
    """The write, if whoever brings it in can do so; else TypeError, KeyError or AttributeError."""
    kinds = (write.id, str), (write.document, dict), (write.update, bool), (write.size, int), (write.add, dict)
    topic, stamps = messages_of(write)
    whole = write.collection in COLLECTIONS and all(isinstance(value, kind) for value, kind in kinds)
    if not (whole and isinstance(topic, str) and all(isinstance(stamp, int) for stamp in stamps)):
        raise TypeError(f"{write.id!r} is no write to {', '.join(COLLECTIONS)}")
    if stamps and not isinstance(write.document["recording"], str):
        raise TypeError(f"{write.id!r} names no recording")
    return write


def _record(write: Write) -> dict[str, Any]:
    return {
        "collection": write.collection,
        "id": write.id,
        "document": dict(write.document),
        "update": write.update,
        "size": write.size,
        "add": dict(write.add),
    }
