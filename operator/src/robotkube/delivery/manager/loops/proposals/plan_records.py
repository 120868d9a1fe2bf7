"""The manager's records of its plans: bounded, rebuilt from main's commits after a restart, served as JSON."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from robotkube.delivery.deployment.core.commit_messages import INITIAL, CommitMessage, read_message
from robotkube.delivery.deployment.core.releases import RELEASES
from robotkube.delivery.manager.core.composition.inputs import Composition
from robotkube.delivery.manager.core.plans import ADD, CHANGE, REMOVE, Plan, answered_and_withdrawn, decided
from robotkube.delivery.manager.core.release_differences import ReleaseDifferences, release_differences
from robotkube.errors import DocumentError
from robotkube.foundation.forge.ports.repositories import Commit

RECORDS_MAX = 1000
DIFFERENCES_MAX = 100
"""Of so many plans the changed values and the choices are remembered: those of an older one are in its commit and its
pull request."""
CHOICES_MAX = 40
"""So many choices of a plan are told: its pull request has them all."""
TIMES = ("demand_seen", "started", "proposed", "merged", "synced", "observed")


@dataclass
class PlanRecord:
    """The record of one plan. `times` are ns since 1970, by the names in TIMES; `created`, `changed`, `removed` are
    release keys; `differences` the values that change (None: nobody remembers them, the commit has them); `choices` are
    task and sentence of what was decided; `waits` is reason and message for the tasks of a proposal that waits longer
    than usual; `unreachable` are old pods on dead nodes: the plan is observed but for them."""

    id: str
    subject: str
    cause: str
    tasks: tuple[str, ...]
    events: tuple[str, ...]
    traces: tuple[str, ...] = ()
    base: str = ""
    commit: str = ""
    created: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    differences: ReleaseDifferences | None = None
    choices: tuple[tuple[str, str], ...] = ()
    pull_request: int | None = None
    url: str = ""
    error: str | None = None
    on_main: bool = False
    waits: tuple[str, str] | None = None
    unreachable: tuple[str, ...] = ()
    times: dict[str, int] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The record in the form of GET /plans."""
        return {
            "plan": self.id,
            "subject": self.subject,
            "cause": self.cause,
            "tasks": list(self.tasks),
            "events": list(self.events),
            "traces": list(self.traces),
            "commit": self.commit or None,
            "pull_request": self.pull_request,
            "url": self.url or None,
            "created": list(self.created),
            "changed": list(self.changed),
            "removed": list(self.removed),
            "differences": self.differences.as_json() if self.differences else None,
            "choices": [{"task": task, "choice": choice} for task, choice in self.choices],
            "error": self.error,
            "waits": self.waits[1] if self.waits and not self.on_main else None,
            "on_main": self.on_main,
            **{name: self.times.get(name) for name in TIMES},
        }


class PlanRecords:
    """The last RECORDS_MAX plans by id, oldest first."""

    def __init__(self, started: int) -> None:
        self._started = started
        self._records: OrderedDict[str, PlanRecord] = OrderedDict()

    def __iter__(self) -> Iterator[PlanRecord]:
        return iter(list(self._records.values()))

    def add(self, record: PlanRecord) -> PlanRecord:
        """Remember a plan; the oldest goes when there are too many."""
        self._records[record.id] = record
        while len(self._records) > RECORDS_MAX:
            self._records.popitem(last=False)
        for old in islice(reversed(self._records.values()), DIFFERENCES_MAX, DIFFERENCES_MAX + 1):
            old.differences = None
            old.choices = ()
        return record

    def has_merged(self, plan: str) -> bool:
        """Return whether the plan is remembered as one on main."""
        return plan in self._records and self._records[plan].on_main

    def committed(self, task: str) -> PlanRecord | None:
        """The newest plan on main that names the task."""
        records = (r for r in reversed(list(self._records.values())) if task in r.tasks and r.on_main)
        return next(records, None)

    def as_json(self) -> dict[str, Any]:
        """The document of GET /plans."""
        return {"started": self._started, "plans": [record.as_json() for record in self]}


def record_of(plan: Plan, desired: Composition, demand_seen: int, started: int) -> PlanRecord:
    """The record of a new plan towards what is `desired`."""
    keys = {kind: tuple(c.release.key for c in plan.changes if c.kind == kind) for kind in (ADD, CHANGE, REMOVE)}
    come, go = answered_and_withdrawn(plan.changes)
    return PlanRecord(
        id=plan.id,
        subject=plan.title,
        cause="task" if come else "withdrawal" if go else _kind(plan.message),
        tasks=tuple(c.task for c in plan.message.causes),
        events=tuple(c.event for c in plan.message.causes),
        traces=tuple(c.trace for c in plan.message.causes),
        base=plan.base,
        created=keys[ADD],
        changed=keys[CHANGE],
        removed=keys[REMOVE],
        differences=release_differences(plan.changes),
        choices=tuple(islice(decided(plan, desired), CHOICES_MAX)),
        times={"demand_seen": demand_seen, "started": started},
    )


def records_of(commits: Iterable[Commit], manager: str) -> Iterator[PlanRecord]:
    """The records of the plans of `manager` among main's commits (oldest first); other commits are left out. Their
    times are not known any more; `on_main` says that they were merged."""
    for commit in commits:
        try:
            message = read_message(commit.message)
        except DocumentError:
            continue
        if message.manager != manager:
            continue
        paths = [path for path in commit.changes if path.startswith(f"{RELEASES}/")]
        yield PlanRecord(
            id=message.plan,
            subject=message.subject,
            cause=_cause(message),
            tasks=tuple(c.task for c in message.causes),
            events=tuple(c.event for c in message.causes),
            traces=tuple(c.trace for c in message.causes),
            base=commit.parents[0] if commit.parents else "",
            commit=commit.id,
            changed=tuple(_key(path) for path in paths if commit.changes[path] is not None),
            removed=tuple(_key(path) for path in paths if commit.changes[path] is None),
            on_main=True,
        )


def _cause(message: CommitMessage) -> str:
    if not message.causes:
        return _kind(message)
    return "withdrawal" if message.verb == "withdraw" else "task"


def _kind(message: CommitMessage) -> str:
    return message.kinds[0] if message.kinds else INITIAL


def _key(path: str) -> str:
    return path.removeprefix(f"{RELEASES}/").removesuffix(".yaml")
