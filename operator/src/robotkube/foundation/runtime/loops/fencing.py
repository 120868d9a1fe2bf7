"""Fencing: a process acts for its release (sends, publishes, writes to the database) only while the release is its own.

A node that was cut off keeps its pods running, and after a stated time another process may have taken a release over.
When the node is back, the old process must do nothing that both would do before it has read its own settings anew. It
is fenced

- after a connection was lost and made again (`doubt`), unless they were read within FRESH_SECONDS before: no release is
  taken over as fast as that;
- while the API server has been out of reach for longer than GAP_SECONDS_MAX;
- at its start, until they were read for the first time.

A release that cannot be taken over (its settings do not say `movable`) is fenced at most BOUND_SECONDS_MAX, and only
after `doubt`: a vehicle may be without the API server for hours while it has the broker.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from robotkube.errors import UnavailableError

if TYPE_CHECKING:  # the ports know every part's domain: 25 ms of a start
    from robotkube.foundation.runtime.ports import SettingsSource

FRESH_SECONDS = 10.0
GAP_SECONDS_MAX = 30.0
BOUND_SECONDS_MAX = 5.0
ASKED_SECONDS_MIN = 1.0
NODE, MOVABLE = "node", "movable"


def is_movable(settings: Mapping[str, str]) -> bool:
    """Whether a release with this ConfigMap could be taken over: by another agent, or by another Node of its own."""
    return settings.get(MOVABLE) == "true" or NODE in settings


class Fencing:
    """The fencing of one process on `node`; without `movable` and `follow` it is never fenced. All methods may be
    called from any thread. `clock` counts seconds, also while the machine sleeps."""

    def __init__(self, node: str = "", movable: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._movable = movable
        self._clock = clock
        self._reading: SettingsSource | None = None
        self._lock = threading.Lock()
        self._needed: float | None = None
        self._doubted_at = self._asked_at = float("-inf")
        self._lost = False

    def follow(self, reading: SettingsSource) -> None:
        """Use `reading` from now on, which says when the settings were read."""
        self._reading = reading

    @property
    def lost(self) -> bool:
        """Whether the release was lost: gone, or on another node, after a time without the API server."""
        return self._lost

    @property
    def sure(self) -> bool:
        """Whether the process may act: it is not fenced."""
        if self._lost:
            return False
        if self._reading is None:
            return not self._movable
        if not self._movable:
            return self._was_read or self._clock() - self._doubted_at >= BOUND_SECONDS_MAX
        since = self._reading.interrupted_at
        reached = since is None or self._clock() - since <= GAP_SECONDS_MAX
        return reached and self._reading.read_at is not None and self._was_read

    def check(self) -> None:
        """UnavailableError when the process may not act now."""
        if not self.sure:
            raise UnavailableError("the settings have to be read anew first: another node may run this release by now")

    @property
    def _was_read(self) -> bool:
        """Whether the settings were read as late as the last interruption needs it."""
        needed = self._needed
        read_at = self._reading.read_at if self._reading is not None else None
        return needed is None or (read_at is not None and read_at >= needed)

    def doubt(self) -> None:
        """Fence the process after an interruption: have the settings read anew, unless that has just been done."""
        if self._reading is None:
            return
        with self._lock:
            now = self._clock()
            if self.sure:
                self._doubted_at = now
            self._needed = now - FRESH_SECONDS
            ask = not self._was_read and now - self._asked_at >= ASKED_SECONDS_MIN
            if ask:
                self._asked_at = now
        if ask:
            self._reading.read_again()

    def told(self, settings: Mapping[str, str] | None) -> bool:
        """Note what the ConfigMap holds now, None when there is none; whether the release is still that of this
        process."""
        own = settings is not None and self._node in ("", settings.get(NODE, self._node))
        if not own and not self.sure:
            self._lost = True
        if settings is not None:
            self._movable = is_movable(settings)
        return own

    def metrics(self) -> str:
        """The state in Prometheus' text format."""
        return f"robotkube_settings_unsure {int(not self.sure)}\n"
