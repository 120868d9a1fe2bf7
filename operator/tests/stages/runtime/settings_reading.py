"""A source of settings that a process has read when a test says so."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Reading:
    """Port SettingsSource; the test sets what it answers."""

    read_at: float | None = None
    interrupted_at: float | None = None
    asked: int = 0

    def read_again(self) -> None:
        """Counted."""
        self.asked += 1
