"""The file of deliveries that wait: `<folder>/deliveries.jsonl`, a line of JSON when one comes, and one when it is
gone.

A line that a kill or a full disk has cut off is left out when the file is read; every part that is written begins with
an empty line, so that nothing is lost with it.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.robots.reactions.ports.deliveries import EdgeDelivery, JournalEntry

READ_BYTES_MAX = 64 * 1024 * 1024
"""Twice the size to which a file can grow while it is written anew."""


class DeliveryFile:
    """The deliveries of a folder (port DeliveryLog). One process at a time has it; the lock ends with the process."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "deliveries.jsonl"
        self._lock = self._file = -1
        self.size = 0

    def open(self) -> Sequence[JournalEntry]:
        """See the port."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if self._lock < 0:
            self._lock = self._lock_folder()
        self._path.with_suffix(".part").unlink(missing_ok=True)
        self._append_to()
        with self._path.open("rb") as file:
            return _entries(file.read(READ_BYTES_MAX).split(b"\n"))

    def write(self, added: Sequence[JournalEntry], removed: Sequence[tuple[str, str]]) -> None:
        """See the port."""
        self._require_file()
        lines = [_removal_line(reaction, identity) for reaction, identity in removed] + [
            _line(entry) for entry in added
        ]
        self.size += _write(self._file, b"\n" + b"".join(lines))
        if added:
            os.fdatasync(self._file)

    def replace(self, entries: Sequence[JournalEntry]) -> None:
        """See the port: a file without entries is made empty, the others are replaced as a whole."""
        self._require_file()
        if not entries:
            os.ftruncate(self._file, 0)
            self.size = 0
            return
        part = self._path.with_suffix(".part")
        try:
            with part.open("wb") as file:
                file.writelines(_line(entry) for entry in entries)
                file.flush()
                os.fsync(file.fileno())
            part.rename(self._path)
        except OSError:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        self._append_to()

    def close(self) -> None:
        """See the port."""
        for number in (self._file, self._lock):
            if number >= 0:
                os.close(number)
        self._lock = self._file = -1

    def _lock_folder(self) -> int:
        """Open and lock the folder; returns its descriptor."""
        descriptor = os.open(self._folder, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise OSError(f"{self._folder}: another process keeps its deliveries there; give each a folder") from error
        except OSError:
            os.close(descriptor)
            raise
        return descriptor

    def _require_file(self) -> None:
        if self._file < 0:
            self._append_to()

    def _append_to(self) -> None:
        """Open the file that has the name now for appending, and write its name to the disk."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
        self._file = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self.size = os.fstat(self._file).st_size
        os.fsync(self._lock)


def _write(file: int, data: bytes) -> int:
    written = 0
    while written < len(data):
        written += os.write(file, data[written:])
    return written


def _line(entry: JournalEntry) -> bytes:
    delivery = entry.delivery
    document = {
        "reaction": entry.reaction,
        "name": entry.name,
        "time": entry.time,
        "id": delivery.id,
        "edge": delivery.edge,
        "trace": delivery.trace,
        "body": delivery.body.decode(),
    }
    return json.dumps(document).encode() + b"\n"


def _removal_line(reaction: str, identity: str) -> bytes:
    return json.dumps({"gone": [reaction, identity]}).encode() + b"\n"


def _entries(lines: Iterable[bytes]) -> list[JournalEntry]:
    entries: dict[tuple[str, str], JournalEntry] = {}
    for line in lines:
        with suppress(ValueError, KeyError, TypeError, AttributeError):
            document = read_json(line)
            if "gone" in document:
                reaction, identity = document["gone"]
                entries.pop((reaction, identity), None)
            else:
                entry = _entry(document)
                entries[entry.reaction, entry.delivery.id] = entry
    return list(entries.values())


def _entry(document: dict[str, object]) -> JournalEntry:
    texts = [document[key] for key in ("id", "edge", "trace", "body", "reaction", "name")]
    identity, edge, trace, body, reaction, name = (str(text) for text in texts)
    time = document["time"]
    if not isinstance(time, int):
        raise TypeError("time is no integer")
    return JournalEntry(reaction, name, time, EdgeDelivery(identity, edge, trace, body.encode()))
