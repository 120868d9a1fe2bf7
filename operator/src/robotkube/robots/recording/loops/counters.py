"""Counters of recorders and journals; numbers only grow."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class RecorderCounts:
    """Counters of the offered messages; numbers only grow. `first_stored`: topic -> time of its first index
    acknowledgement, ns."""

    offered: int = 0
    early: int = 0
    dropped: int = 0
    duplicates: int = 0
    documents: int = 0
    segments: int = 0
    acknowledged: int = 0
    first_stored: dict[str, int] = field(default_factory=dict)

    def numbers(self, dropped: int = 0) -> dict[str, int]:
        """The counters by name. `dropped`: messages that the journal has given up, added to the recorder's own."""
        counters = {name: value for name, value in vars(self).items() if isinstance(value, int)}
        return counters | {"dropped": self.dropped + dropped}


@dataclass
class JournalCounts:
    """Counters of writes; numbers only grow."""

    acknowledged: int = 0
    retries: int = 0
    spooled: int = 0
    dropped: int = 0
    repaired: int = 0
    discarded: int = 0
