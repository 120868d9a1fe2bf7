"""Reports of bridges about links that they do not carry, the last of each."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence

from robotkube.errors import DocumentError
from robotkube.robots.bridge.core.link_reports import LinkReport, read_report

RELEASES_MAX = 1000

log = logging.getLogger(__name__)


class LinkReports:
    """The last report by release; `receive` is called by the gateway's thread, the rest by the manager's. `changed` is
    called when what is reported changed."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._reports: dict[str, LinkReport] = {}
        self._lock = threading.Lock()

    def receive(self, release: str, payload: bytes, size: int) -> None:
        """Receive a message about a release (key), of `size` bytes (`payload` may be left out when it is too long). One
        that cannot be read is logged, and changes nothing."""
        try:
            report = read_report(release, payload, size)
        except DocumentError as error:
            log.error("links not understood reason=%r", str(error))
            return
        with self._lock:
            before = self._reports.pop(release, None)
            if report is not None:
                self._reports[release] = report
            while len(self._reports) > RELEASES_MAX:
                self._reports.pop(next(iter(self._reports)))
        if report != before:
            count = len(report.faults) if report else 0
            log.info("links release=%s not_carried=%d", release, count)
            self._changed()

    def __call__(self) -> Sequence[LinkReport]:
        """The reports, of whatever process sent them."""
        with self._lock:
            return list(self._reports.values())
