"""The ledger: the tasks that are demands now.

Every TaskDescription is an entry; its demand stands from the object's creation until it is deleted (withdrawn) or its
lease runs out (expired). A renewal moves the end of the lease, a changed spec is a new generation of the same demand,
and the same key can stand only once. Releases exist while a demand on them stands: what the ledger leaves out goes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from robotkube.delivery.deployment.core.releases import TaskCause
from robotkube.delivery.manager.core.composition.inputs import Refused
from robotkube.delivery.tasks.core.refusal_outlooks import without_outlook
from robotkube.delivery.tasks.core.task_description import (
    INVALID_PARAMETERS,
    LEASE_EXPIRED,
    POSTPONED,
    SETTLED_REASONS,
    TaskDescription,
    read_task,
)
from robotkube.errors import DocumentError
from robotkube.foundation.documents.core.times import time_ns
from robotkube.foundation.kubernetes.core.annotations import RENEWED_ANNOTATION
from robotkube.foundation.kubernetes.core.objects import is_withdrawn, object_identity, object_key


@dataclass(frozen=True)
class StandingDemands:
    """The demands of one moment, by key in order of creation, then of key. `refused` are entries that are no demand:
    expired, or unreadable. `next_due_ns` is when the next lease runs out (None: none does)."""

    live: Mapping[str, TaskDescription] = field(default_factory=dict)
    refused: Mapping[str, Refused] = field(default_factory=dict)
    next_due_ns: int | None = None


@dataclass(frozen=True)
class PastDecision:
    """The earlier decisions about a task's present generation, from its status: since when it waits in the queue (ns
    since 1970), how a conflict was settled, and whether it was offloaded."""

    waiting_since_ns: int | None = None
    settled: Refused | None = None
    offloaded: bool = False


Stamp = tuple[str, int]
"""Identity and generation of an object."""


@dataclass(frozen=True)
class Asked:
    """What a task asks for, in which generation of which object; Refused for one that cannot be read."""

    stamp: Stamp
    task: TaskDescription | Refused

    def answered_by(self, cause: TaskCause) -> bool:
        """Return whether a release with this cause is there for what is asked, not for earlier parameters."""
        if isinstance(self.task, Refused):
            return False
        own = self.task.cause
        return (cause.task, cause.application, cause.parameters) == (own.task, own.application, own.parameters)


_Read = tuple[str, Mapping[str, Any], Any, Any, Asked]
"""The key of a task, its document, the document's metadata and spec, and what was read from these two."""


class TaskReader:
    """A reader of tasks that keeps what it read until the document changes. Metadata and spec are values: what was
    given once stays as it is, and a task that changed comes with others."""

    def __init__(self) -> None:
        self._read: dict[str, _Read] = {}
        self._by_metadata: dict[int, _Read] = {}

    def read(self, documents: Iterable[Mapping[str, Any]]) -> dict[str, TaskDescription | Refused]:
        """Every task that is not being deleted, by key; Refused for one that cannot be read. The newest of several
        documents with one key counts."""
        entries: dict[str, _Read] = {}
        for document in documents:
            if is_withdrawn(document):
                continue
            metadata = document.get("metadata")
            spec = document.get("spec")
            entry = self._by_metadata.get(id(metadata))
            if entry is None or entry[3] is not spec:
                entry = self._entry(document, metadata, spec)
            elif entry[1] is not document:
                entry = (entry[0], document, *entry[2:])
            entries[entry[0]] = entry
        self._read = entries
        self._by_metadata = {id(entry[2]): entry for entry in entries.values()}  # kept, so that the ids stay theirs
        return {key: entry[4].task for key, entry in entries.items()}

    def _entry(self, document: Mapping[str, Any], metadata: Any, spec: Any) -> _Read:
        key = object_key(document)
        known = self._read.get(key)
        if known is not None and _equal(_inputs(known[2], known[3]), _inputs(metadata, spec)):
            return key, document, metadata, spec, known[4]
        return key, document, metadata, spec, Asked(stamp_of(document), _task(document))

    def document(self, key: str) -> Mapping[str, Any]:
        """The document that a task was last read from; KeyError when it was not there."""
        return self._read[key][1]

    def asked(self) -> dict[str, Asked]:
        """What each task asked for when it was read last, by key."""
        return {key: entry[4] for key, entry in self._read.items()}


def stamp_of(document: Mapping[str, Any]) -> Stamp:
    """Which object, in which generation, a document is."""
    return object_identity(document), int(document.get("metadata", {}).get("generation", 1))


def _inputs(metadata: Mapping[str, Any] | None, spec: Any) -> Any:
    """The parts of a document that `read_task` reads."""
    names = ("uid", "creationTimestamp", "generation", "annotations")
    return [(metadata or {}).get(name) for name in names], spec


def _equal(first: Any, second: Any) -> bool:
    try:
        return bool(first == second)
    except RecursionError:  # nested so deeply that it is refused anyway
        return False


def _task(document: Mapping[str, Any]) -> TaskDescription | Refused:
    try:
        return read_task(document)
    except DocumentError as error:
        return Refused(INVALID_PARAMETERS, str(error))


def demands_at(tasks: Mapping[str, TaskDescription | Refused], now_ns: int) -> StandingDemands:
    """The demands among the tasks that stand at `now_ns` (ns since 1970)."""
    readable = {key: task for key, task in tasks.items() if isinstance(task, TaskDescription)}
    refused = {key: task for key, task in tasks.items() if isinstance(task, Refused)}
    live: dict[str, TaskDescription] = {}
    due: list[int] = []
    for _, key in sorted((task.created, key) for key, task in readable.items()):
        task = readable[key]
        end = task.expires_ns
        if end is not None and end <= now_ns:
            refused[key] = Refused(LEASE_EXPIRED, _expired(task, end))
            continue
        live[key] = task
        due += [end] if end is not None else []
    return StandingDemands(live, refused, min(due, default=None))


def _expired(task: TaskDescription, end: int) -> str:
    return (
        f"the lease of {task.lease_seconds} s ran out at {moment(end)}; "
        f"set the annotation {RENEWED_ANNOTATION} to the present time to ask again"
    )


def moment(time_ns_: int) -> str:
    """The RFC 3339 text in UTC, whole seconds, of ns since 1970."""
    return datetime.fromtimestamp(time_ns_ // 1_000_000_000, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def past_decision(document: Mapping[str, Any]) -> PastDecision:
    """The earlier decisions in the status of a task; none when the status is about an older generation."""
    status = document.get("status") or {}
    if status.get("observedGeneration") != document.get("metadata", {}).get("generation", 1):
        return PastDecision()
    accepted: Mapping[str, Any] = next((c for c in status.get("conditions", []) if c.get("type") == "Accepted"), {})
    reason = accepted.get("reason")
    message = without_outlook(str(reason), str(accepted.get("message", "")))
    settled = Refused(reason, message) if reason in SETTLED_REASONS and accepted.get("status") == "False" else None
    since = (status.get("queue") or {}).get("since") if reason == POSTPONED else None
    return PastDecision(_nanoseconds(since), settled, bool(status.get("offloaded")))


def _nanoseconds(text: Any) -> int | None:
    try:
        return time_ns(text) if isinstance(text, str) else None
    except (ValueError, OverflowError):
        return None
