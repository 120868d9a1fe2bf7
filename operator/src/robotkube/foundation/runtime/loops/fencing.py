"""Fencing: a process acts for its release (sends, publishes, writes to the database) only while the release is its own.

A node that was cut off keeps its pods running, and after a stated time another process may have taken a release over.
When the node is back, the old process must do nothing that both would do before it has read its own settings anew. It
is fenced

- after a connection was lost and made again (`interrupted`), unless they were read within FRESH_SECONDS before: no
  release is taken over as fast as that;
- while the API server has been out of reach for longer than GAP_SECONDS_MAX;
- at its start, until they were read for the first time.

A release that cannot be taken over (its settings do not say `movable`) is fenced at most BOUND_SECONDS_MAX, and only
after `interrupted`: a vehicle may be without the API server for hours while it has the broker.
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
REQUEST_SECONDS_MIN = 1.0
NODE = "node"
MOVABLE = "movable"


def is_movable(settings: Mapping[str, str]) -> bool:
    """Return whether a release with this ConfigMap could be taken over: by another agent, or by another Node of its
    own."""
    return settings.get(MOVABLE) == "true" or NODE in settings


class Fencing:
    """The fencing of one process on `node`; without `movable` and `watch` it is never fenced. All methods may be
    called from any thread. `clock` counts seconds, also while the machine sleeps."""

    def __init__(self, node: str = "", movable: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._movable = movable
        self._clock = clock
        self._settings: SettingsSource | None = None
        self._lock = threading.Lock()
        self._needed: float | None = None
        self._interrupted_at = float("-inf")
        self._requested_at = float("-inf")
        self._lost = False

    def watch(self, settings: SettingsSource) -> None:
        """Use `settings` from now on, which says when the settings were read."""
        self._settings = settings

    @property
    def lost(self) -> bool:
        """Return whether the release was lost: gone, or on another node, after a time without the API server."""
        return self._lost

    @property
    def fenced(self) -> bool:
        """Return whether the process must not act now."""
        if self._lost:
            return True
        if self._settings is None:
            return self._movable
        if not self._movable:
            return not self._was_read and self._clock() - self._interrupted_at < BOUND_SECONDS_MAX
        since = self._settings.interrupted_at
        reached = since is None or self._clock() - since <= GAP_SECONDS_MAX
        return not (reached and self._settings.read_at is not None and self._was_read)

    def check(self) -> None:
        """Refuse with UnavailableError while the process is fenced."""
        if self.fenced:
            raise UnavailableError("the settings have to be read anew first: another node may run this release by now")

    @property
    def _was_read(self) -> bool:
        """Return whether the settings were read as late as the last interruption needs it."""
        needed = self._needed
        read_at = self._settings.read_at if self._settings is not None else None
        return needed is None or (read_at is not None and read_at >= needed)

    def interrupted(self) -> None:
        """Fence the process after an interruption of its connection: have the settings read anew, unless that has just
        been done."""
        if self._settings is None:
            return
        with self._lock:
            now = self._clock()
            if not self.fenced:
                self._interrupted_at = now
            self._needed = now - FRESH_SECONDS
            request = not self._was_read and now - self._requested_at >= REQUEST_SECONDS_MIN
            if request:
                self._requested_at = now
        if request:
            self._settings.read_again()

    def observe(self, settings: Mapping[str, str] | None) -> bool:
        """Note the content of the ConfigMap, None when there is none; return whether the release is still that of this
        process."""
        own = settings is not None and self._node in ("", settings.get(NODE, self._node))
        if not own and self.fenced:
            self._lost = True
        if settings is not None:
            self._movable = is_movable(settings)
        return own

    def metrics(self) -> str:
        """The state in Prometheus' text format."""
        return f"robotkube_settings_fenced {int(self.fenced)}\n"
