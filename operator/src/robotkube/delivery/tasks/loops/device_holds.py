"""Holds that devices set by message, kept until they are over or released."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence

from robotkube.delivery.tasks.core.holds import PAYLOAD_BYTES_MAX, DeviceHold, message_hold
from robotkube.errors import DocumentError

log = logging.getLogger(__name__)


class DeviceHolds:
    """The holds by message, one per agent; `receive` is called by the gateway's thread, the rest by the manager's.

    `changed` is called when what is held changed; `now_ns` is the wall clock in ns since 1970.
    """

    def __init__(self, now_ns: Callable[[], int], changed: Callable[[], None]) -> None:
        self._now_ns = now_ns
        self._changed = changed
        self._holds: dict[str, DeviceHold] = {}
        self._lock = threading.Lock()

    def receive(self, agent: str, payload: bytes, size: int) -> None:
        """Receive a message of `agent`, of `size` bytes (`payload` may be left out when it is too long). One that
        cannot be read is logged, and changes nothing."""
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

    def __call__(self) -> Sequence[DeviceHold]:
        """The holds that have not expired."""
        now = self._now_ns()
        with self._lock:
            self._holds = {agent: hold for agent, hold in self._holds.items() if hold.until_ns > now}
            return list(self._holds.values())
