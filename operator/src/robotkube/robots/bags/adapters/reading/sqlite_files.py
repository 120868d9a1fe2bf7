"""One sqlite3 file of rosbag2, of any version: tables `topics`, `messages`, and `message_definitions` when there."""

from __future__ import annotations

import sqlite3
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.robots.bags.adapters.reading.metadata import topic
from robotkube.robots.bags.core.playback import BagTopic

MESSAGE_BYTES_MAX = 1024 * 1024 * 1024
TOPICS_MAX = 100_000
TIME_MAX = 2**63 - 1
SERIALISATION = "cdr"
DEFINITION = "ros2msg"
BEGIN = b"SQLite format 3\0"
_NO_FORMS: Mapping[str, str] = {}
_WAYS = (("?mode=ro", False), ("?mode=ro&immutable=1", False), ("?mode=ro&immutable=1", True))
"""How to open: the first sees what a crashed writer left in its journal; the last, lenient one reads a file that is
shorter than it says."""
_FAULTS = (sqlite3.Error, ValueError, OverflowError, MemoryError)  # sqlite's messages may be no UTF-8 when damaged


class SqliteFile:
    """One open sqlite3 file. InputError at construction: not a file of this kind. `complain` hears of damage, of the
    file as `named`. `forms`: topic -> how metadata.yaml says that its messages are serialised, for topics of which
    the file says nothing."""

    def __init__(
        self,
        path: Path,
        complain: Callable[[str], None],
        named: Path | None = None,
        forms: Mapping[str, str] = _NO_FORMS,
    ) -> None:
        self._path = named or path
        self._complain = complain
        self._forms = forms
        self._database = self._open(path)
        try:
            self._names: dict[int, str] = {}
            self.topics = self._read_topics()
            self.definitions = self._read_definitions()
        except Exception:
            self._database.close()
            raise

    def close(self) -> None:
        """Give the file back."""
        self._database.close()

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time and message in the order of the times; of the topics `wanted`, all when None."""
        numbers = [n for n, name in self._names.items() if wanted is None or name in wanted]
        times, places = self._order(numbers)
        order: Sequence[int] = range(len(times))
        if any(times[i] > times[i + 1] for i in range(len(times) - 1)):
            order = sorted(order, key=times.__getitem__)
        for index in order:
            row = self._row("SELECT topic_id, data FROM messages WHERE rowid = ?", int(places[index]))
            if row is None or not isinstance(row[1], bytes) or row[0] not in self._names:
                self._complain(f"{self._path}: message {places[index]} cannot be read; left out")
                continue
            yield self._names[row[0]], times[index], row[1]

    def _open(self, path: Path) -> sqlite3.Connection:
        try:
            with path.open("rb") as file:
                if file.read(len(BEGIN)) != BEGIN:
                    raise InputError(f"{self._path}: is no sqlite3 file")
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror})") from error
        problem: Exception | None = None
        for way, lenient in _WAYS:
            database = sqlite3.connect(f"{path.resolve().as_uri()}{way}", uri=True, isolation_level=None)
            try:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MESSAGE_BYTES_MAX)
                if lenient:
                    database.execute("PRAGMA writable_schema = ON")
                database.execute("SELECT count(*) FROM sqlite_master").fetchone()
            except _FAULTS as error:
                database.close()
                problem = problem or error
                continue
            if lenient:
                self._complain(f"{self._path}: cut off or damaged ({problem}); what is readable is used")
            return database
        raise InputError(f"{self._path}: is no readable sqlite3 file: {problem}") from problem

    def _read_topics(self) -> list[BagTopic]:
        columns = self._columns("topics")
        if not {"id", "name", "type"} <= set(columns) or "timestamp" not in self._columns("messages"):
            raise InputError(f"{self._path}: has no tables topics and messages of rosbag2, or they are damaged")
        wanted = ("id", "name", "type", "serialization_format", "offered_qos_profiles")
        chosen = ", ".join(name if name in columns else f"'' AS {name}" for name in wanted)
        topics: list[BagTopic] = []
        for number, name, type_name, form, offered in self._rows(f"SELECT {chosen} FROM topics"):  # noqa: S608
            if not (isinstance(number, int) and isinstance(name, str) and isinstance(type_name, str)):
                self._complain(f"{self._path}: a row of topics is damaged; left out")
            elif (form or self._forms.get(name, SERIALISATION)) != SERIALISATION:
                said = form or f"{self._forms[name]} by metadata.yaml"
                self._complain(f"{self._path}: topic {name} is {said}; only {SERIALISATION} is read")
            elif len(topics) < TOPICS_MAX:
                self._names[number] = name
                topics.append(topic(name, type_name, offered))
        return topics

    def _read_definitions(self) -> dict[str, str]:
        if not self._columns("message_definitions"):
            return {}
        rows = self._rows("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        return {name: text for name, form, text in rows if form == DEFINITION and text and isinstance(text, str)}

    def _order(self, numbers: Sequence[int]) -> tuple[array[int], array[int]]:
        """Times and row numbers of the messages, as far as they can be read."""
        times = array("q")
        places = array("q")
        last = -(2**63)
        chosen = set(numbers)
        for place, number, moment in self._rows("SELECT rowid, topic_id, timestamp FROM messages ORDER BY rowid"):
            if not isinstance(place, int) or place <= last:
                self._complain(f"{self._path}: its messages are damaged behind number {last}; what is before is read")
                break
            last = place
            if number in chosen and isinstance(moment, int) and 0 <= moment <= TIME_MAX:
                times.append(moment)
                places.append(place)
        return times, places

    def _columns(self, table: str) -> list[str]:
        with suppress(*_FAULTS):
            return [str(row[1]) for row in self._database.execute(f"PRAGMA table_info({table})")]
        return []

    def _rows(self, query: str) -> Iterator[tuple[Any, ...]]:
        """The rows of a query, up to the first that cannot be read."""
        try:
            yield from self._database.execute(query)
        except _FAULTS as error:
            self._complain(f"{self._path}: damaged ({error}); what is readable is used")

    def _row(self, query: str, number: int) -> tuple[Any, ...] | None:
        with suppress(*_FAULTS):
            row: tuple[Any, ...] | None = self._database.execute(query, (number,)).fetchone()
            return row
        return None
