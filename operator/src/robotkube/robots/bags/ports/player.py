"""The ports of a player of bags: bags, ledgers and a clock."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from robotkube.robots.bags.core.playback import BagTopic, LedgerState


class Bag(Protocol):
    """Recorded messages with times from the start of the run."""

    @property
    def topics(self) -> Sequence[BagTopic]:
        """The topics in the bag."""
        ...

    def messages(self) -> Iterable[tuple[str, int, bytes]]:
        """Topic, offset in ns and serialised message, offsets ascending. InputError where the bag is damaged."""
        ...


class Ledgers(Protocol):
    """One append-only ledger per run and topic."""

    def open(self, run: str, topic: str) -> LedgerState:
        """Open a ledger for appending; its state so far. A torn last line is cut off. InputError when it cannot be."""
        ...

    def append(self, topic: str, line: str) -> None:
        """Add a line to the open ledger of the topic; kept in memory until `flush`."""
        ...

    def flush(self) -> None:
        """Write what was appended."""
        ...

    def close(self) -> None:
        """Flush and close all ledgers of the run."""
        ...


class PlaybackClock(Protocol):
    """The shared clock of all players."""

    def now(self) -> int:
        """Time in ns since 1970."""
        ...

    def sleep(self, nanoseconds: int) -> None:
        """Return after that time, or earlier."""
        ...
