"""Reporting looks: the Inspection's status, an Event and a log line for each stranger that comes or goes, and metrics.

A status is written when it says something else than before, and otherwise every HEARTBEAT_SECONDS, so that a look
that stopped is seen to have: seventeen nodes that are as they should be cost a write a second.

What was written is not believed to stay: who may write Inspections, or have admission change or refuse what is written,
could make a stranger unnamed. So all are read every few seconds, what is not as it was written is written again, and
what the API server answers to a write is compared with what was sent.
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
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.times import time_ns, time_text
from robotkube.foundation.runtime.ports import Series

HEARTBEAT_SECONDS = 15  # by the next look after that, so after 20 s at the latest
GONE = "StrangerGone"

log = logging.getLogger(__name__)

Status = Mapping[str, Any]
GAUGES = {
    "strangers": "What runs and may not, in the last look.",
    "look_age_seconds": "Time since anything was seen there.",
    "unseen": "1 where the last look could not see.",
}
REFUSED, CHANGED, UNANSWERED = "Refused", "Changed", "Unanswered"
COUNTERS = {
    "write_failures_total": "Writes of Inspections after which they were not as they were sent.",
    "restored_total": "Inspections that somebody else had changed or deleted, and that were written again.",
}


class Reporter:
    """Reports looks; `now_ns` is the wall clock. Not for several threads, but for `metrics`."""

    def __init__(self, inspections: Inspections, now_ns: Callable[[], int]) -> None:
        self._inspections = inspections
        self._now_ns = now_ns
        self._written: dict[str, Status] = {}  # by the name of the Inspection
        self._hindered: set[str] = set()  # whose last write failed: the next look tries again
        self._failures: Counter[tuple[str, ...]] = Counter()
        self._restored = 0
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
        if look.name in self._hindered or not _is_same(before, status, now):
            self._write(look, status)
        self._report_changes(look, before, status)

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
                self._hindered.discard(name)

    def known(self, name: str) -> tuple[Stranger, ...]:
        """The strangers that the Inspection `name` has now."""
        return strangers_of(self._before(name))

    def attend(self, others: str = "") -> None:
        """Read all Inspections: write again those that are not as they were written here, and take those that begin
        with `others`, which another process writes, for the metrics. Errors as those of `report`, after all were
        tried."""
        standing = self._inspections.standing("")
        if others:
            self._hear(others, standing)
        problems: list[InputError | UnavailableError] = []
        for name, status in list(self._written.items()):
            if name in self._hindered or own(standing.get(name) or {}) == status:
                continue
            log.warning("inspection restored name=%s was=%s", name, "changed" if name in standing else "deleted")
            try:
                self._write(look_of(name, status), status)
                self._restored += 1
            except (InputError, UnavailableError) as error:
                problems.append(error)
        if problems:
            raise problems[0]

    def _hear(self, prefix: str, standing: Mapping[str, Status]) -> None:
        heard = {name: status for name, status in standing.items() if name.startswith(prefix)}
        with self._lock:
            for name in [name for name in self._looks if name.startswith(prefix)]:
                del self._looks[name]
                self._looked_ns.pop(name, None)
            for name, status in heard.items():
                self._looks[name] = look_of(name, status)
                if "observedTime" in status:
                    self._looked_ns[name] = time_ns(status["observedTime"])

    def _write(self, look: Look, status: Status) -> None:
        """Write a status, and see that it was taken as it is."""
        try:
            answered = own(self._inspections.write(look, status))
        except (InputError, UnavailableError) as error:
            self._hindered.add(look.name)
            self._failures[(REFUSED if isinstance(error, InputError) else UNANSWERED,)] += 1
            raise
        if answered != status:
            self._hindered.add(look.name)
            self._failures[(CHANGED,)] += 1
            raise InputError(
                f"Inspection {look.name}: the API server has something else than what was written, so do not believe "
                "it. Look for a mutating policy or webhook on inspections, or a changed definition"
            )
        self._hindered.discard(look.name)
        self._written[look.name] = status

    def metrics(self) -> list[Series]:
        """Strangers by place and reason, and how old the last look that saw anything is; for any thread."""
        with self._lock:
            looks = list(self._looks.values())
            looked = dict(self._looked_ns)
        now = self._now_ns()
        places = {look.name: (look.looks_at, look.node) for look in looks}
        strangers: Counter[tuple[str, ...]] = Counter(
            (*places[look.name], stranger.reason) for look in looks for stranger in look.strangers
        )
        ages: dict[tuple[str, ...], float] = {places[name]: (now - at) / 1e9 for name, at in looked.items()}
        unseen: dict[tuple[str, ...], float] = {
            places[look.name]: float(bool(look.problem or look.partly)) for look in looks
        }
        counted = {key: float(count) for key, count in strangers.items()}
        restored: dict[tuple[str, ...], float] = {(): float(self._restored)}
        results = (REFUSED, CHANGED, UNANSWERED)
        failures: dict[tuple[str, ...], float] = {(kind,): float(self._failures[(kind,)]) for kind in results}
        return [
            _gauge("strangers", counted, "reason"),
            _gauge("look_age_seconds", ages),
            _gauge("unseen", unseen),
            _counter("write_failures_total", failures, "result"),
            _counter("restored_total", restored),
        ]

    def _before(self, name: str) -> Status:
        if name not in self._written:
            self._written[name] = own(self._inspections.status(name) or {})
        return self._written[name]

    def _report_changes(self, look: Look, before: Status, status: Status) -> None:
        """Of strangers that came or went since the status before."""
        if look.problem:
            return
        earlier = {stranger.key: stranger for stranger in strangers_of(before)}
        later = {stranger.key: stranger for stranger in strangers_of(status)}
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
    """Return whether `status` says nothing new, and what stands is young enough."""
    if {**before, "observedTime": ""} != {**status, "observedTime": ""}:
        return False
    return now_ns - time_ns(before["observedTime"]) < HEARTBEAT_SECONDS * 10**9 if "observedTime" in before else True


def _fields(look: Look, one: Stranger) -> tuple[str, ...]:
    place = (one.kind, one.namespace or "-", one.name, one.container or "-")
    return (look.name, *place, one.message, one.reason)


def _gauge(name: str, values: Mapping[tuple[str, ...], float], *labels: str) -> Series:
    return Series(f"robotkube_inspection_{name}", "gauge", GAUGES[name], values, ("looks_at", "node", *labels))


def _counter(name: str, values: Mapping[tuple[str, ...], float], *labels: str) -> Series:
    return Series(f"robotkube_inspection_{name}", "counter", COUNTERS[name], values, labels)
