"""Reporting looks: the Inspection's status, an Event and a log line for each stranger that comes or goes, and metrics.

A status is written when it says something else than before, and otherwise every HEARTBEAT_SECONDS, so that a look
that stopped is seen to have: seventeen nodes that are as they should be cost a write every few seconds.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robotkube.delivery.inspection.core.statuses import look_of, own, status_of, strangers_of
from robotkube.delivery.inspection.core.strangers import Look, Stranger
from robotkube.delivery.inspection.ports import Inspections
from robotkube.foundation.documents.core.times import time_ns, time_text
from robotkube.foundation.runtime.ports import Series

HEARTBEAT_SECONDS = 60
GONE = "StrangerGone"

log = logging.getLogger(__name__)

Status = Mapping[str, Any]
GAUGES = {
    "strangers": "What runs and may not, in the last look.",
    "look_age_seconds": "Time since anything was seen there.",
    "unseen": "1 where the last look could not see.",
}


class Reporter:
    """Reports looks; `now_ns` is the wall clock. Not for several threads, but for `metrics`."""

    def __init__(self, inspections: Inspections, now_ns: Callable[[], int]) -> None:
        self._inspections = inspections
        self._now_ns = now_ns
        self._written: dict[str, Status] = {}  # by the name of the Inspection
        self._lock = threading.Lock()
        self._looks: dict[str, Look] = {}
        self._looked_ns: dict[str, int] = {}

    def report(self, look: Look) -> None:
        """Report one look. UnavailableError and InputError as the Inspections raise them: the next look reports what
        this one could not."""
        now = self._now_ns()
        with self._lock:
            self._looks[look.name] = look
            if not look.problem:
                self._looked_ns[look.name] = now
        before = self._before(look.name)
        status = status_of(look, before, time_text(now))
        if not _is_same(before, status, now):
            self._inspections.write(look, status)
            self._written[look.name] = status
        self._tell(look, before, status)

    def forget_others(self, names: Iterable[str], prefix: str) -> None:
        """Remove the Inspections that begin with `prefix` and are none of `names`: their nodes are gone."""
        wanted = set(names)
        for name in self._inspections.names():
            if name.startswith(prefix) and name not in wanted:
                self._inspections.remove(name)
                log.info("inspection removed name=%s", name)
        with self._lock:
            for name in [name for name in self._looks if name.startswith(prefix) and name not in wanted]:
                del self._looks[name]
                self._looked_ns.pop(name, None)
                self._written.pop(name, None)

    def known(self, name: str) -> tuple[Stranger, ...]:
        """The strangers that the Inspection `name` has now."""
        return strangers_of(self._before(name))

    def hear(self, prefix: str) -> None:
        """Read the Inspections that begin with `prefix`, which another process writes, for the metrics."""
        standing = self._inspections.standing(prefix)
        with self._lock:
            for name in [name for name in self._looks if name.startswith(prefix)]:
                del self._looks[name]
                self._looked_ns.pop(name, None)
            for name, status in standing.items():
                self._looks[name] = look_of(name, status)
                if "observedTime" in status:
                    self._looked_ns[name] = time_ns(status["observedTime"])

    def metrics(self) -> list[Series]:
        """Strangers by place and reason, and how old the last look that saw anything is; for any thread."""
        with self._lock:
            looks, looked = list(self._looks.values()), dict(self._looked_ns)
        now = self._now_ns()
        places = {look.name: (look.looks_at, look.node) for look in looks}
        strangers: Counter[tuple[str, ...]] = Counter(
            (*places[look.name], one.reason) for look in looks for one in look.strangers
        )
        ages: dict[tuple[str, ...], float] = {places[name]: (now - at) / 1e9 for name, at in looked.items()}
        unseen: dict[tuple[str, ...], float] = {
            places[look.name]: float(bool(look.problem or look.partly)) for look in looks
        }
        counted = {key: float(count) for key, count in strangers.items()}
        return [_gauge("strangers", counted, "reason"), _gauge("look_age_seconds", ages), _gauge("unseen", unseen)]

    def _before(self, name: str) -> Status:
        if name not in self._written:
            self._written[name] = own(self._inspections.status(name) or {})
        return self._written[name]

    def _tell(self, look: Look, before: Status, status: Status) -> None:
        """Of strangers that came or went since the status before."""
        if look.problem:
            return
        earlier = {one.key: one for one in strangers_of(before)}
        later = {one.key: one for one in strangers_of(status)}
        for key in sorted(later.keys() - earlier.keys()):
            log.warning(
                "stranger appeared inspection=%s kind=%s namespace=%s name=%s container=%s message=%r reason=%s",
                *_fields(look, later[key]),
            )
            self._inspections.report(look, later[key].reason, later[key])
        for key in sorted(earlier.keys() - later.keys()):
            log.warning(
                "stranger gone inspection=%s kind=%s namespace=%s name=%s container=%s message=%r reason=%s",
                *_fields(look, earlier[key]),
            )
            self._inspections.report(look, GONE, earlier[key])


def _is_same(before: Status, status: Status, now_ns: int) -> bool:
    """Whether `status` says nothing new, and what stands is young enough."""
    if {**before, "observedTime": ""} != {**status, "observedTime": ""}:
        return False
    return now_ns - time_ns(before["observedTime"]) < HEARTBEAT_SECONDS * 10**9 if "observedTime" in before else True


def _fields(look: Look, one: Stranger) -> tuple[str, ...]:
    place = (one.kind, one.namespace or "-", one.name, one.container or "-")
    return (look.name, *place, one.message, one.reason)


def _gauge(name: str, values: Mapping[tuple[str, ...], float], *labels: str) -> Series:
    return Series(f"robotkube_inspection_{name}", "gauge", GAUGES[name], values, ("looks_at", "node", *labels))
