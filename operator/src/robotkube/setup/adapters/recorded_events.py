"""What the database of recordings has of one recording (pymongo)."""

from __future__ import annotations

from typing import Any

from pymongo.database import Database

from robotkube.foundation.database.adapters.connection import translated
from robotkube.robots.recording.core.documents import INDEX, RECORDINGS, SAMPLES


class DatabaseRecording:
    """The port RecordedEvents: the recording of that name."""

    def __init__(self, database: Database[dict[str, Any]], recording: str) -> None:
        self._database = database
        self._recording = recording

    def answers(self) -> None:
        """Return when the database answers a reading command of this account."""
        self._own()

    def messages(self) -> bool:
        """Return whether a message, small or large, is stored."""
        if self._own() is None:
            return False  # it is written before all else; not every server finds the rest without reading everything
        with translated(f"reading recording {self._recording}"):
            wanted = {"recording": self._recording}
            return any(self._database[name].find_one(wanted, {"_id": 1}) is not None for name in (SAMPLES, INDEX))

    def ended(self) -> bool:
        """Return whether the recorder has written its end."""
        own = self._own()
        return own is not None and own.get("ended") is not None

    def _own(self) -> dict[str, Any] | None:
        with translated(f"reading recording {self._recording}"):
            return self._database[RECORDINGS].find_one({"_id": self._recording}, {"ended": 1})
