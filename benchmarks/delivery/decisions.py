"""How long the application manager takes to decide, measured in a process of its own on any checkout of the project.

    PYTHONPATH=<checkout>/operator/src python -P benchmarks/delivery/decisions.py [COUNT]

Prints a JSON document with milliseconds. The inventory has 500 chart versions, 1,000 nodes and 200 demands that main
meets already.
`still`: main stays as it is, one task is new and goes again. `moving`: one task is new and the oldest has gone; the
plan is merged before the next one comes, so each decision reads other releases on main. `reading`: main read after
each merge. A decision goes from the documents of all tasks to the finished plan, with everything that the manager's
process does for it (ledger, versions, composing, schema validation in its own process).

Names are looked up by several paths, so that the same file measures checkouts from before modules moved.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

COUNT = 200
WARMING_UP = 5
START_NS = 1_795_250_000_000_000_000
EXPECTED = {"charts": 500, "nodes": 1000, "demands": 200}

MODULES = {
    "BoundedSchemas": ("registry.catalogue.adapters.bounded_validation", "entrypoints.bounded_schemas"),
    "Jinja2Templates": ("foundation.documents.adapters.jinja2_templates", "adapters.templates_jinja2"),
    "MainReader": ("delivery.manager.loops.main_reader", "services.manager_reading"),
    "ManagerSettings": ("delivery.manager.loops.planner", "services.manager_planning"),
    "MemoryCluster": ("testing.clusters",),
    "MemoryRepository": ("testing.forges",),
    "MemoryTasks": ("testing.clusters",),
    "Planner": ("delivery.manager.loops.planner", "services.manager_planning"),
    "Sweeper": ("foundation.runtime.garbage_collection", "entrypoints.sweeping"),
    "synthetic": ("testing.synthetic",),
    "write_release": ("delivery.deployment.core.releases", "domain.releases"),
    "write_source": ("delivery.deployment.core.releases", "domain.releases"),
}
"""Where a name lies below the package robotkube: now, and before modules moved."""


def imported(name: str) -> Any:
    """The object of that name from the first of its modules that exists."""
    for module in MODULES[name]:
        try:
            return getattr(importlib.import_module(f"robotkube.{module}"), name)
        except ModuleNotFoundError:
            continue
    raise ModuleNotFoundError(f"{name} is in none of {', '.join(MODULES[name])}")


@dataclass(frozen=True)
class KnownCatalogue:
    """A catalogue that needs no evidence, as the planner reads it."""

    catalogue: Any
    schema: Callable[[str, str], Mapping[str, Any] | None]
    tip: str = "0" * 40


def document(task: Any) -> dict[str, Any]:
    """The object that the API server holds."""
    event = {"rule": task.rule, "id": task.event, "trace": task.trace, "time": task.created}
    spec = {"requester": task.requester, "event": event, "reason": task.reason}
    spec |= {"application": task.application, "parameters": task.parameters}
    metadata = {"namespace": task.namespace, "name": task.name, "generation": 1, "creationTimestamp": task.created}
    return {"metadata": metadata, "spec": spec}


class Manager:
    """A planner as its process has it, with everything it reads in memory."""

    def __init__(self, schemas: Any) -> None:
        render = imported("Jinja2Templates")().render
        self._inventory = imported("synthetic")(render, schemas.validate)
        self._check()
        known: Any = imported("MemoryTasks")

        class Tasks(known):  # type: ignore[misc]
            """Gives the objects as they are, without copies, as the watch of the API server does."""

            def tasks(self) -> Sequence[Mapping[str, Any]]:
                return list(self.objects.values())

        self._tasks = Tasks({key: document(task) for key, task in self._inventory.tasks.items()})
        self._repository = imported("MemoryRepository")()
        self._repository.push(self._files(), "the demands before")
        self._main = imported("MainReader")(self._repository)
        self._main.read()
        self._planner = self._started(render, schemas)
        self._rest = imported("Sweeper")(time.monotonic)

    def _check(self) -> None:
        counts = {
            "charts": sum(len(versions) for versions in self._inventory.catalogue.charts.values()),
            "nodes": len(self._inventory.nodes),
            "demands": len(self._inventory.tasks),
        }
        if counts != EXPECTED:
            raise ValueError(f"the inventory has {counts}, it must have {EXPECTED}")

    def _files(self) -> dict[str, str]:
        tree = self._inventory.tree
        release = imported("write_release")
        source = imported("write_source")
        files = {path: release(known) for path, known in tree.releases.items()}
        return files | {path: source(known) for path, known in tree.sources.items()}

    def _started(self, render: Any, schemas: Any) -> Any:
        settings = imported("ManagerSettings")(self._inventory.agents, "oci://forge.example/verified")
        catalogue = KnownCatalogue(self._inventory.catalogue, self._inventory.schema)
        cluster = imported("MemoryCluster")(list(self._inventory.nodes))
        given = (settings, self._tasks, cluster, catalogue, self._main, render)
        if not hasattr(schemas, "ahead"):  # before values were checked while the planner goes on
            return imported("Planner")(*given, schemas.validate)
        ahead = schemas.ahead()
        return imported("Planner")(*given, ahead.validate, settled=ahead.settled)

    def still(self, number: int) -> float:
        """Milliseconds of the decision about one new task, which is gone afterwards."""
        task = self._inventory.new_task(number)
        milliseconds, _ = self._decided(task, number)
        del self._tasks.objects[task.key]
        self._rest()  # as the manager does between two steps
        return milliseconds

    def moving(self, number: int) -> tuple[float, float]:
        """Milliseconds of the decision about one new task while the oldest has gone, and of reading main after the
        plan was merged."""
        task = self._inventory.new_task(number)
        created = datetime.fromisoformat(task.created) + timedelta(seconds=number)
        task = replace(task, created=created.strftime("%Y-%m-%dT%H:%M:%SZ"))
        self._tasks.objects.pop(next(iter(self._tasks.objects)))
        milliseconds, plan = self._decided(task, number)
        self._repository.push(plan.files, plan.title)
        began = time.perf_counter()
        self._main.read()
        reading = 1000 * (time.perf_counter() - began)
        self._rest()
        return milliseconds, reading

    def _decided(self, task: Any, number: int) -> tuple[float, Any]:
        self._tasks.objects[task.key] = document(task)
        began = time.perf_counter()
        plan = self._planner.plan(START_NS + number * 1_000_000_000)
        milliseconds = 1000 * (time.perf_counter() - began)
        if plan is None or task.key not in [cause.task for cause in plan.message.causes]:
            raise ValueError(f"{task.key} led to {plan and plan.title}, not to a plan for it")
        return milliseconds, plan


def measured(count: int) -> dict[str, list[float]]:
    """Milliseconds of each decision, main still and then moving, and of each reading of main."""
    schemas = imported("BoundedSchemas")()
    try:
        manager = Manager(schemas)
        still = [manager.still(number) for number in range(WARMING_UP + count)][WARMING_UP:]
        first = WARMING_UP + count
        moving = [manager.moving(first + number) for number in range(WARMING_UP + count)][WARMING_UP:]
    finally:
        schemas.close()
    return {"still": still, "moving": [pair[0] for pair in moving], "reading": [pair[1] for pair in moving]}


if __name__ == "__main__":
    print(json.dumps(measured(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT)))
