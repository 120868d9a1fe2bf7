"""What recorders and journals count; numbers only grow."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class RecorderCounts:
    """What happened to the offered messages; numbers only grow. `first_stored`: topic -> time of its first index
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
        """By name; `dropped`: what the journal gave up beside."""
        found = {name: value for name, value in vars(self).items() if isinstance(value, int)}
        return found | {"dropped": self.dropped + dropped}


@dataclass
class JournalCounts:
    """What happened to writes; numbers only grow."""

    acknowledged: int = 0
    retries: int = 0
    spooled: int = 0
    dropped: int = 0
    repaired: int = 0
    discarded: int = 0
