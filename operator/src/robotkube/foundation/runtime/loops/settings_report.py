"""The report of a process about its own settings: whether the newest that it was given are at work.

A process that follows its ConfigMap is ready only while they are: its pod stays when they change, so nothing else says
that it took them.
"""

from __future__ import annotations

PENDING = "changed settings are not at work yet"
REFUSED = "the newest settings are refused, the ones before are at work"


class SettingsReport:
    """Each text of settings is `given`, and then `taken` or `refused`. All methods may be called from any thread."""

    def __init__(self) -> None:
        self._given = ""
        self._taken = ""
        self._refused: tuple[str, str] = ("", "")

    def given(self, text: str) -> None:
        """Note that the process was given a text."""
        self._given = text

    def taken(self, text: str) -> None:
        """Note that a text is at work."""
        self._taken = text

    def refused(self, text: str, why: str) -> None:
        """Note that a text was refused."""
        self._refused = (text, why)

    @property
    def at_work(self) -> str:
        """The text that is at work, empty before the first."""
        return self._taken

    @property
    def refusal(self) -> str:
        """The reason why the newest text was refused; empty when it was not."""
        text, why = self._refused
        return why if text == self._given != self._taken else ""

    @property
    def complaint(self) -> str | None:
        """The reason why the newest text is not at work, or None."""
        if self.refusal:
            return f"{REFUSED}: {self.refusal}"
        return None if self._given == self._taken else PENDING

    def metrics(self) -> str:
        """The state in Prometheus' text format."""
        return f"robotkube_settings_refused {int(bool(self.refusal))}\n"
