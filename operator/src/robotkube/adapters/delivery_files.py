"""Deliveries that wait, as lines of JSON: `<folder>/deliveries.jsonl`, one line when one comes, one when it is gone.

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

from robotkube.ports.reactions import Delivery, KeptDelivery

READ_BYTES_MAX = 64 * 1024 * 1024
"""Twice what a file can grow to while it is written anew."""


class DeliveryFile:
    """Port DeliveryLog. One process at a time has the folder; the lock ends with the process."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._path = folder, folder / "deliveries.jsonl"
        self._lock = self._file = -1
        self.size = 0

    def open(self) -> Sequence[KeptDelivery]:
        """See the port."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if self._lock < 0:
            self._lock = self._locked()
        self._path.with_suffix(".part").unlink(missing_ok=True)
        self._append_to()
        with self._path.open("rb") as file:
            return _entries(file.read(READ_BYTES_MAX).split(b"\n"))

    def write(self, added: Sequence[KeptDelivery], removed: Sequence[tuple[str, str]]) -> None:
        """See the port."""
        self._require_file()
        lines = [_gone(reaction, identity) for reaction, identity in removed] + [_line(entry) for entry in added]
        self.size += _write(self._file, b"\n" + b"".join(lines))
        if added:
            os.fdatasync(self._file)

    def replace(self, entries: Sequence[KeptDelivery]) -> None:
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

    def _locked(self) -> int:
        """The folder, open, and ours."""
        found = os.open(self._folder, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(found)
            raise OSError(f"{self._folder}: another process keeps its deliveries there; give each a folder") from error
        except OSError:
            os.close(found)
            raise
        return found

    def _require_file(self) -> None:
        if self._file < 0:
            self._append_to()

    def _append_to(self) -> None:
        """The file that has the name now, whose name is on the disk."""
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


def _line(entry: KeptDelivery) -> bytes:
    one = entry.delivery
    document = {
        "reaction": entry.reaction,
        "name": entry.name,
        "time": entry.time,
        "id": one.id,
        "edge": one.edge,
        "trace": one.trace,
        "body": one.body.decode(),
    }
    return json.dumps(document).encode() + b"\n"


def _gone(reaction: str, identity: str) -> bytes:
    return json.dumps({"gone": [reaction, identity]}).encode() + b"\n"


def _entries(lines: Iterable[bytes]) -> list[KeptDelivery]:
    found: dict[tuple[str, str], KeptDelivery] = {}
    for line in lines:
        with suppress(ValueError, KeyError, TypeError, AttributeError):
            document = json.loads(line)
            if "gone" in document:
                reaction, identity = document["gone"]
                found.pop((reaction, identity), None)
            else:
                entry = _entry(document)
                found[entry.reaction, entry.delivery.id] = entry
    return list(found.values())


def _entry(document: dict[str, object]) -> KeptDelivery:
    texts = [document[key] for key in ("id", "edge", "trace", "body", "reaction", "name")]
    identity, edge, trace, body, reaction, name = (str(text) for text in texts)
    time = document["time"]
    if not isinstance(time, int):
        raise TypeError("time is no integer")
    return KeptDelivery(reaction, name, time, Delivery(identity, edge, trace, body.encode()))
