"""Durations of steps when they were last done, kept in the cache folder: what the next estimate is."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from ci.folders import user_cache

FILE = "durations.json"
STEPS_MAX = 1000
SECONDS_MIN = 1.0  # what is done sooner needs no estimate


class Durations:
    """The seconds of each kind of step, the one that was done last at the end. A file that cannot be read or written
    costs the estimates alone."""

    def __init__(self, folder: Path | None = None) -> None:
        self._file = (folder or user_cache()) / FILE

    def last(self, step: str) -> float | None:
        """The seconds that the step took when it was last done; None when nobody knows."""
        return self.known().get(step)

    def note(self, step: str, seconds: float) -> None:
        """Keep how long the step took."""
        self.note_all({step: seconds})

    def note_all(self, steps: Mapping[str, float]) -> None:
        """The same for several."""
        new = {step: round(seconds, 1) for step, seconds in steps.items() if seconds >= SECONDS_MIN}
        if not new:
            return
        known = {name: value for name, value in self.known().items() if name not in new}
        kept = dict([*known.items(), *new.items()][-STEPS_MAX:])
        part = self._file.with_name(f"{FILE}.{os.getpid()}.part")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            part.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
            part.replace(self._file)
        except OSError:
            part.unlink(missing_ok=True)

    def known(self) -> Mapping[str, float]:
        """How long each step took when it was last done."""
        try:
            document = json.loads(self._file.read_text(encoding="utf-8"))
            return {str(name): float(seconds) for name, seconds in document.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}
