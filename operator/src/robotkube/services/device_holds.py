"""Vetoes that devices say by message, kept until they are over or released."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence

from robotkube.domain.errors import DocumentError
from robotkube.domain.holds import PAYLOAD_BYTES_MAX, Hold, message_hold

log = logging.getLogger(__name__)


class DeviceHolds:
    """One hold per agent; `receive` is called by the thread of the door, the rest by the manager's.

    `changed` is called when what is held changed; `now_ns` is the wall clock in ns since 1970.
    """

    def __init__(self, now_ns: Callable[[], int], changed: Callable[[], None]) -> None:
        self._now_ns, self._changed = now_ns, changed
        self._holds: dict[str, Hold] = {}
        self._lock = threading.Lock()

    def receive(self, agent: str, payload: bytes, size: int) -> None:
        """A message of `agent`, of `size` bytes (`payload` may be left out when it is too long). One that cannot be
        read is said in the log, and changes nothing."""
        try:
            hold = message_hold(agent, payload if size <= PAYLOAD_BYTES_MAX else b" " * size, self._now_ns())
        except DocumentError as error:
            log.error("hold not understood reason=%r", str(error))
            return
        with self._lock:
            before = self._holds.get(agent)
            self._holds.pop(agent, None)
            if hold is not None:
                self._holds[agent] = hold
        if hold != before:
            log.info("hold agent=%s text=%r", agent, hold.text if hold else "released")
            self._changed()

    def __call__(self) -> Sequence[Hold]:
        """The holds that last."""
        now = self._now_ns()
        with self._lock:
            self._holds = {agent: hold for agent, hold in self._holds.items() if hold.until_ns > now}
            return list(self._holds.values())
