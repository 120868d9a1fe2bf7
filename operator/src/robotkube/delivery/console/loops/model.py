"""The read model of the console: the one table that everything it reads goes into, for any thread.

Documents that need others are made here: whom a release answers, which event a task names before its detector was
read, where a chart version runs.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.chains import View
from robotkube.delivery.console.core.documents import (
    Documents,
    catalogue_documents,
    decision_documents,
    event_documents,
    event_of_task,
    plan_documents,
)
from robotkube.delivery.console.core.table import ItemTable, TableChange
from robotkube.foundation.runtime.ports import Series, by_one

EVENTS_MAX = 5000
RECORDINGS_MAX = 1000
DECISIONS_MAX = 1000
PREFIX = "robotkube_console_"

Document = Mapping[str, Any]


class ReadModel:
    """The table and what it is made of. `epoch` is another one after each start; `now_ms` is the wall clock."""

    def __init__(self, epoch: str, now_ms: Callable[[], int]) -> None:
        self.epoch = epoch
        self.now_ms = now_ms
        self._table = ItemTable()
        self._lock = threading.RLock()
        self._listeners: list[Callable[[], None]] = []
        self._catalogues: dict[str, Document] = {}
        self._decisions: dict[int, Document] = {}  # by pull request, the newest last

    def listen(self, changed: Callable[[], None]) -> None:
        """Call `changed` after every change from now on, on the thread that made it; it must return at once."""
        self._listeners.append(changed)

    @contextmanager
    def _changing(self) -> Iterator[ItemTable]:
        with self._lock:
            before = self._table.version
            yield self._table
            changed = self._table.version != before
        if changed:
            for listener in self._listeners:
                listener()

    # what is read -------------------------------------------------------------------------------------------------

    @property
    def version(self) -> int:
        """The version now."""
        return self._table.version

    def whole(self) -> TableChange:
        """All items."""
        with self._lock:
            return self._table.whole()

    def since(self, version: int) -> TableChange | None:
        """What changed after a version; None when that cannot be reported."""
        with self._lock:
            return self._table.since(version)

    def documents(self, kind: str) -> Mapping[str, Document]:
        """The documents of a kind, by key."""
        with self._lock:
            return self._table.documents(kind)

    def view(self) -> View:
        """What chains are made of."""
        with self._lock:
            names = (kinds.TASKS, kinds.PLANS, kinds.RELEASES, kinds.PODS, kinds.EVENTS, kinds.RECORDINGS)
            return View(*(self._table.documents(name) for name in names))

    def metrics(self) -> Sequence[Series]:
        """What the table holds, and which sources are away."""
        with self._lock:
            counts = {kind: float(self._table.count(kind)) for kind in kinds.KINDS}
            sources = self._table.documents(kinds.SOURCES)
            version = float(self._table.version)
        away = {name: float(not source["ok"]) for name, source in sources.items()}
        return (
            Series(f"{PREFIX}items", "gauge", "Items in the table.", by_one(counts), ("kind",)),
            Series(f"{PREFIX}version", "gauge", "Version of the table.", {(): version}),
            Series(f"{PREFIX}source_away", "gauge", "1 while a source is away.", by_one(away), ("source",)),
        )

    # what is written ------------------------------------------------------------------------------------------------

    def put(self, kind: str, key: str, document: Document | None) -> None:
        """An item is there with this document, or there is none."""
        with self._changing() as table:
            _put(table, kind, key, document)

    def replace(self, kind: str, documents: Documents, prefix: str = "") -> None:
        """The items of a kind, or those whose keys begin with `prefix`, are these and no others."""
        with self._changing() as table:
            _replace(table, kind, documents, lambda key, _: key.startswith(prefix))

    def put_task(self, key: str, task: Document | None) -> None:
        """A task is there with this document, or there is none; its event and its releases say so, too."""
        with self._changing() as table:
            before = table.get(kinds.TASKS, key)
            _put(table, kinds.TASKS, key, task)
            event = "" if task is None else task["event"]["id"]
            if task is not None and event and table.get(kinds.EVENTS, event) is None:
                table.put(kinds.EVENTS, event, event_of_task(task))
                _bound_events(table)
            for release in {one for document in (before, task) if document for one in document["releases"]}:
                standing = table.get(kinds.RELEASES, release)
                if standing is not None:
                    table.put(kinds.RELEASES, release, _demanded(table, standing))

    def put_release(self, key: str, release: Document | None) -> None:
        """A release is there with this document, or there is none."""
        with self._changing() as table:
            _put(table, kinds.RELEASES, key, None if release is None else _demanded(table, release))

    def put_plans(self, page: Document, manager: str) -> None:
        """The plans of a manager are those of this page."""
        with self._changing() as table:
            documents = {key: self._decided(plan) for key, plan in plan_documents(page, manager).items()}
            _replace(table, kinds.PLANS, documents, lambda _, document: document["manager"] == manager)

    def put_decisions(self, page: Document) -> None:
        """The gate's page /decisions, by which plans know what was checked. What it said before stays, as long as there
        is place: a gate forgets when it starts anew."""
        with self._changing() as table:
            for number, decision in decision_documents(page).items():
                self._decisions.pop(number, None)
                self._decisions[number] = decision
            for number in list(self._decisions)[:-DECISIONS_MAX]:
                del self._decisions[number]
            for key, plan in table.documents(kinds.PLANS).items():
                decided = self._decided(plan)
                if decided["decision"] != plan["decision"]:
                    table.put(kinds.PLANS, key, decided)

    def _decided(self, plan: Document) -> dict[str, Any]:
        """A plan with what the gate said of its pull request."""
        return {**plan, "decision": self._decisions.get(plan["pull_request"])}

    def put_catalogue(self, manager: str, page: Document | None = None) -> None:
        """A manager's page /catalogue, with where its chart versions run now; None: the page is that of before."""
        with self._changing() as table:
            if page is not None:
                self._catalogues[manager] = page
            releases = tuple(table.documents(kinds.RELEASES).values())
            documents: Documents = {}
            for catalogue in self._catalogues.values():
                documents |= catalogue_documents(catalogue, releases)
            _replace(table, kinds.CATALOGUE, documents, lambda *_: True)

    def put_events(self, page: Document, detector: str) -> None:
        """What a detector's page /events has; what fell out of it before stays, as long as there is place. Of events
        that another agent's detector told it says nothing."""
        documents = event_documents(page, detector)
        with self._changing() as table:
            for key, document in documents.items():
                before = table.get(kinds.EVENTS, key)
                if before is not None and before["detector"] and _reporter(before) != _reporter(document):
                    continue
                if document["began_ms"] is None and before is not None:  # its beginning has fallen out of the page
                    document = {**before, "ended_ms": document["ended_ms"]}
                table.put(kinds.EVENTS, key, document)
            _bound_events(table)

    def put_recordings(self, documents: Documents) -> None:
        """Recordings as their detector has them; what was told before stays, as long as there is place."""
        with self._changing() as table:
            for key, document in documents.items():
                table.put(kinds.RECORDINGS, key, document)
            _bound(table, kinds.RECORDINGS, RECORDINGS_MAX, lambda recording: recording["at_work"])

    def leave_recordings(self, detectors: Collection[str]) -> None:
        """End the recordings of all detectors but these: nobody is at work on them any more."""
        with self._changing() as table:
            for key, document in table.documents(kinds.RECORDINGS).items():
                if document["at_work"] and document["detector"] not in detectors:
                    table.put(kinds.RECORDINGS, key, {**document, "at_work": False})

    def put_source(self, name: str, problem: str, advice: str, carries: Sequence[str]) -> None:
        """A source answers (`problem` is empty), or does not and why."""
        with self._changing() as table:
            before = table.get(kinds.SOURCES, name)
            same = before is not None and before["ok"] == (not problem)
            table.put(
                kinds.SOURCES,
                name,
                {
                    "name": name,
                    "ok": not problem,
                    "problem": problem,
                    "advice": advice if problem else "",
                    "since_ms": before["since_ms"] if before is not None and same else self.now_ms(),
                    "carries": list(carries),
                },
            )


def _put(table: ItemTable, kind: str, key: str, document: Document | None) -> None:
    if document is None:
        table.remove(kind, key)
    else:
        table.put(kind, key, document)


def _replace(table: ItemTable, kind: str, documents: Documents, among: Callable[[str, Document], bool]) -> None:
    for key, document in table.documents(kind).items():
        if key not in documents and among(key, document):
            table.remove(kind, key)
    for key, document in documents.items():
        table.put(kind, key, document)


def _demanded(table: ItemTable, release: Document) -> Document:
    """The release with the tasks that ask for it, as their statuses say."""
    tasks = table.documents(kinds.TASKS).items()
    demands = [key for key, task in tasks if release["release"] in task["releases"] and not task["withdrawn"]]
    return {**release, "demands": sorted(demands)}


def _reporter(item: Document) -> str:
    """The namespace of the detector that told of an event or a recording."""
    return str(item["detector"]).partition("/")[0]


def _bound(table: ItemTable, kind: str, most: int, lasts: Callable[[Document], bool]) -> None:
    """Items of detectors go when there are more than `most`: of the agent whose detectors told most, those that do not
    last any more, then the oldest. Who tells without end so loses his own."""
    if table.count(kind) <= most:
        return
    items = table.documents(kind)
    newest_first = sorted(items, key=lambda key: (lasts(items[key]), items[key]["began_ms"] or 0))[::-1]
    reported: dict[str, list[str]] = {}
    for key in newest_first:
        reported.setdefault(_reporter(items[key]), []).append(key)
    for _ in range(len(items) - most):
        table.remove(kind, max(reported.values(), key=len).pop())


def _bound_events(table: ItemTable) -> None:
    _bound(table, kinds.EVENTS, EVENTS_MAX, lambda event: event["ended_ms"] is None)
