"""The ledgers that a player writes, as files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from robotkube.errors import InputError
from robotkube.robots.bags.core.playback import LedgerState, ledger_name, read_ledger

LEDGER_BYTES_MAX = 1024 * 1024 * 1024


class LedgerFiles:
    """Ledgers below `folder`: `<run>/<topic with / as __>.jsonl`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, BinaryIO] = {}
        self._lines: dict[str, list[str]] = {}

    def open(self, run: str, topic: str) -> LedgerState:
        """Open a ledger for appending; its state so far, as the port says."""
        path = self._folder / run / ledger_name(topic)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("ab+", buffering=0)
            file.seek(0)
            state = read_ledger(file.read(LEDGER_BYTES_MAX))
            file.truncate(state.whole_bytes)
            file.seek(0, os.SEEK_END)
        except OSError as error:
            raise InputError(f"{path}: the ledger cannot be written: {error}; see `ledger` and its volume") from error
        self._files[topic] = file
        self._lines[topic] = []
        return state

    def append(self, topic: str, line: str) -> None:
        """Add a line to the open ledger of the topic."""
        self._lines[topic].append(line)

    def flush(self) -> None:
        """Write what was appended."""
        for topic, lines in self._lines.items():
            if lines:
                data = "".join(lines).encode("ascii")
                written = 0
                while written < len(data):
                    written += self._files[topic].write(data[written:])
                lines.clear()

    def close(self) -> None:
        """Flush and close all ledgers of the run."""
        self.flush()
        for file in self._files.values():
            file.close()
        self._files.clear()
        self._lines.clear()
