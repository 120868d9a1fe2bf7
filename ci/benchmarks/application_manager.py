"""What the application manager costs: a decision, the way of a task to main, a storm of demands, recovery from SIGKILL.

Goals are figures of the project, not ratios, so each is set against its goal; all go to
build/bench/application-manager.json, latencies with n, p50, p95 and p99. `decision_ms` is measured in this process on a
world of 500 chart versions, 1,000 nodes and 200 standing demands: from the documents of all tasks, one of them new, to
the finished plan, with everything that the manager's process does for it (ledger, versions, composing, schema
validation in its own process). The way to main is measured by the benchmark `gate`, storm and recovery by
operator/tests/forge/storm.py.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from ci import preparing
from ci.benchmarks.measuring import Figure, quantiles, record
from ci.errors import SetUpError
from ci.folders import PROJECT
from robotkube.adapters.templates_jinja2 import Jinja2Templates
from robotkube.domain.catalogue import Catalogue
from robotkube.domain.releases import write_release, write_source
from robotkube.domain.tasks import TaskDescription
from robotkube.entrypoints.bounded_schemas import BoundedSchemas
from robotkube.entrypoints.sweeping import Sweeper
from robotkube.services.assured_catalogue import AssuredCatalogue
from robotkube.services.manager_planning import ManagerSettings, Planner
from robotkube.services.manager_reading import MainReader
from robotkube.testing.clusters import MemoryCluster, MemoryTasks
from robotkube.testing.forges import MemoryRepository
from robotkube.testing.synthetic import CHARTS_URL, Synthetic, synthetic

RECORD = PROJECT / "build" / "bench" / "application-manager.json"
TESTS = PROJECT / "operator" / "tests"
DECISIONS = 200
WARMING_UP = 5
DECISION_GOAL_MS = 20.0
DEMANDS, NODES = 500, 1000
STORM_GOAL_SECONDS = 25.0
GROWTH_GOAL_MIB = 32.0
RECOVERY_GOAL_SECONDS = 5.0
SECONDS_MAX = 300
START_NS = 1_795_250_000_000_000_000
EXPECTED = {"charts": 500, "nodes": 1000, "standing": 200}


@dataclass(frozen=True)
class KnownCatalogue:
    """A catalogue that needs no evidence, as the planner reads it."""

    catalogue: Catalogue
    world: Synthetic
    tip: str = "0" * 40

    def schema(self, chart: str, version: str) -> Mapping[str, Any] | None:
        """The values schema of a chart version."""
        return self.world.schema(chart, version)


class KnownTasks(MemoryTasks):
    """Gives the objects as they are, as the watch of the API server does."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """Without copies."""
        return list(self.objects.values())


def document(task: TaskDescription) -> dict[str, Any]:
    """The object that the API server holds."""
    event = {"rule": task.rule, "id": task.event, "trace": task.trace, "time": task.created}
    spec = {"requester": task.requester, "event": event, "reason": task.reason}
    spec |= {"application": task.application, "parameters": task.parameters}
    metadata = {"namespace": task.namespace, "name": task.name, "generation": 1, "creationTimestamp": task.created}
    return {"metadata": metadata, "spec": spec}


class Decisions:
    """A planner before the world, as its process has it; tasks come and go."""

    def __init__(self, schemas: BoundedSchemas) -> None:
        render = Jinja2Templates().render
        self.world = synthetic(render, schemas.validate)
        counts = {
            "charts": sum(len(versions) for versions in self.world.catalogue.charts.values()),
            "nodes": len(self.world.nodes),
            "standing": len(self.world.tasks),
        }
        if counts != EXPECTED:
            raise SetUpError(f"the world has {counts}, it must have {EXPECTED}")
        self.tasks = KnownTasks({key: document(task) for key, task in self.world.tasks.items()})
        repository = MemoryRepository()
        files = {path: write_release(release) for path, release in self.world.tree.releases.items()}
        files |= {path: write_source(source) for path, source in self.world.tree.sources.items()}
        repository.push(files, "standing demands")
        main = MainReader(repository)
        main.read()
        settings = ManagerSettings(self.world.agents, CHARTS_URL)
        catalogue = cast(AssuredCatalogue, KnownCatalogue(self.world.catalogue, self.world))
        cluster = MemoryCluster(list(self.world.nodes))
        self.planner = Planner(settings, self.tasks, cluster, catalogue, main, render, schemas.validate)
        self.rest = Sweeper(time.monotonic)

    def one(self, number: int) -> float:
        """Milliseconds of the decision about one new task; it is gone afterwards."""
        task = self.world.new_task(number)
        self.tasks.objects[task.key] = document(task)
        now_ns = START_NS + number * 1_000_000_000
        began = time.perf_counter()
        plan = self.planner.plan(now_ns)
        took = 1000 * (time.perf_counter() - began)
        if plan is None or [cause.task for cause in plan.message.causes] != [task.key]:
            raise SetUpError(f"{task.key} led to {plan and plan.title}, not to a plan of its own")
        del self.tasks.objects[task.key]
        self.rest()  # as the manager does between two steps
        return took


def decisions() -> list[float]:
    """Milliseconds of each decision."""
    schemas = BoundedSchemas()
    try:
        world = Decisions(schemas)
        return [world.one(number) for number in range(WARMING_UP + DECISIONS)][WARMING_UP:]
    finally:
        schemas.close()


def storm(demands: int, nodes: int) -> dict[str, Any]:
    """What operator/tests/forge/storm.py found."""
    folders = os.pathsep.join(str(path) for path in (PROJECT, PROJECT / "operator" / "src", TESTS))
    environment = {**os.environ, "PYTHONPATH": folders, preparing.TOOLCHAIN_VARIABLE: str(preparing.tool_chain())}
    command = [sys.executable, str(TESTS / "forge" / "storm.py"), str(demands), str(nodes)]
    done = subprocess.run(
        command, env=environment, cwd=PROJECT, capture_output=True, text=True, timeout=SECONDS_MAX, check=False
    )
    if done.returncode:
        raise SetUpError(f"{command[1]} ended with {done.returncode}: {done.stderr[-2000:]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def goal(name: str, unit: str, ours: float, at_most: float) -> Figure:
    """A figure set against its goal."""
    return Figure(name, unit, ours, at_most, 1.0, "the goal")


def figures() -> list[Figure]:
    """A decision, a storm, recovery; each against its goal."""
    return [*decision_figures(), *storm_figures()]


def decision_figures() -> list[Figure]:
    """The decision alone."""
    found = quantiles(decisions())
    record(RECORD, {"decision_ms": asdict(found), "decision_p99_ms": found.p99})
    return [goal(f"decision, p99 of {found.n}", "ms", found.p99, DECISION_GOAL_MS)]


def storm_figures() -> list[Figure]:
    """The storm, once with the nodes of a small fleet and once with 1,000 on the API server."""
    small, large = storm(DEMANDS, 0), storm(DEMANDS, NODES)
    growth = small["rss_mib"][str(DEMANDS)] - small["rss_mib"]["100"]
    record(
        RECORD,
        {
            "storm_seconds": round(small["storm_seconds"], 2),
            "storm_demands_per_second": round(DEMANDS / small["storm_seconds"], 1),
            "storm_plans": small["plans"],
            "storm_rss_mib": small["rss_mib"],
            "storm_rss_growth_mib": round(growth, 1),
            "storm_1000_nodes_seconds": round(large["storm_seconds"], 2),
            "recovery_seconds": round(small["recovery_seconds"], 2),
            "recovery_1000_nodes_seconds": round(large["recovery_seconds"], 2),
        },
    )
    return [
        goal(f"storm of {DEMANDS} demands", "s", small["storm_seconds"], STORM_GOAL_SECONDS),
        goal("memory growth, demand 100 to 500", "MiB", growth, GROWTH_GOAL_MIB),
        goal("recovery to the first decision", "s", small["recovery_seconds"], RECOVERY_GOAL_SECONDS),
    ]


def record_way_to_main(tasks: Sequence[float], floor: Sequence[float], path: Path = RECORD) -> None:
    """What the benchmark `gate` measured of the way to main, in milliseconds."""
    ours, least = quantiles(tasks), quantiles(floor)
    record(
        path,
        {
            "accepted_to_merged_ms": asdict(ours),
            "accepted_to_merged_p95_ms": ours.p95,
            "forge_floor_ms": asdict(least),
            "forge_floor_p95_ms": least.p95,
        },
    )
