"""An election in memory, whose outcome a test decides: port Leadership."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class MemoryLeadership:
    """An election in memory. `number` is the term of this process; None while another one leads, at `other` (None:
    nobody does)."""

    number: int | None = 1
    other: str | None = "another:8080"

    def term(self) -> int | None:
        """The term that the test gave it."""
        return self.number

    def leader(self) -> str | None:
        """The address that the test gave."""
        return self.other if self.number is None else None

    def overtake(self, term: int) -> None:
        """Elect this process again, when it leads at all."""
        if self.number is not None:
            self.number = max(self.number, term + 1)
