"""From the tasks to the next plan: which demands count now, what they lead to, and what the gate refused before."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from robotkube.domain.composition import Demand, Desired, Met, Refused, Validate, World, compose
from robotkube.domain.errors import DocumentError
from robotkube.domain.initial import initial_demands
from robotkube.domain.loops import Render
from robotkube.domain.placement import Agent, fleet
from robotkube.domain.planning import Plan, differences, fingerprint, make_plan
from robotkube.domain.releases import Release
from robotkube.domain.tasks import TaskDescription, is_withdrawn, object_key, read_task
from robotkube.ports.clusters import Cluster, TaskStore
from robotkube.services.assured_catalogue import AssuredCatalogue
from robotkube.services.manager_reading import MainReader
from robotkube.services.manager_records import PlanRecord

TASKS_PER_PLAN_MAX = 100
HELD_MAX = 1000
DOUBTS = frozenset({"NoVerifiedVersion", "GuaranteeNotMet"})

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ManagerSettings:
    """`agents` as declared; `charts_url` is oci://host/organisation."""

    agents: tuple[Agent, ...]
    charts_url: str


class Planner:
    """Computes plans; remembers only what the gate refused, until the inputs of that change."""

    def __init__(
        self,
        settings: ManagerSettings,
        tasks: TaskStore,
        cluster: Cluster,
        catalogue: AssuredCatalogue,
        main: MainReader,
        render: Render,
        validate: Validate,
    ) -> None:
        self._settings, self._store, self._cluster = settings, tasks, cluster
        self._catalogue, self._main, self._render, self._validate = catalogue, main, render, validate
        self._tasks_per_plan = TASKS_PER_PLAN_MAX
        self._held: dict[str, tuple[str, PlanRecord]] = {}
        self._held_differences: dict[str, PlanRecord] = {}
        self._said: frozenset[str] = frozenset()
        self.desired = Desired({}, {})
        self.tasks: Mapping[str, TaskDescription] = {}

    @property
    def held(self) -> Mapping[str, PlanRecord]:
        """Tasks whose plan the gate refused, with that plan."""
        return {key: record for key, (_, record) in self._held.items()}

    def plan(self, started_ns: int) -> Plan | None:
        """The plan that brings main to what is wanted; None when it is there or when the gate refused exactly this."""
        self.tasks, unreadable = self._read()
        desired = self._compose(self._wanted())
        held = {key: Met((), ("accepted, but the gate refused the plan",)) for key in self._held}
        self.desired = replace(desired, outcomes={**desired.outcomes, **held, **unreadable})
        self._say_refusals()
        changes = differences({**self._in_doubt(desired), **desired.releases}, self._main.tree.releases)
        if not changes or fingerprint(changes) in self._held_differences:
            return None
        stamp = datetime.fromtimestamp(started_ns / 1e9, UTC).strftime("%Y%m%d-%H%M%S")
        catalogue, url = self._catalogue.catalogue, self._settings.charts_url
        return make_plan(changes, self._main.tree, self.desired, self.tasks, catalogue, url, self._main.tip, stamp)

    def _read(self) -> tuple[dict[str, TaskDescription], dict[str, Refused]]:
        tasks: dict[str, TaskDescription] = {}
        unreadable: dict[str, Refused] = {}
        for document in self._store.tasks():
            if is_withdrawn(document):
                continue
            try:
                task = read_task(document)
                tasks[task.key] = task
            except DocumentError as error:
                unreadable[object_key(document)] = Refused("InvalidParameters", str(error))
        return tasks, unreadable

    def _wanted(self) -> list[TaskDescription]:
        """The tasks of this plan: all that main answers, and the oldest new ones that are not held."""
        tasks = self.tasks
        self._held = {k: held for k, held in self._held.items() if k in tasks and held[0] == self._inputs(tasks[k])}
        new = [task.key for task in self._new() if task.key not in self._held]
        waiting = {*new[self._tasks_per_plan :], *self._held}
        return [task for key, task in tasks.items() if key not in waiting]

    def _new(self) -> list[TaskDescription]:
        """Tasks that main does not answer yet, oldest first."""
        answered = {cause.task for release in self._main.tree.releases.values() for cause in release.causes}
        return sorted((t for t in self.tasks.values() if t.key not in answered), key=lambda t: (t.created, t.key))

    def _inputs(self, task: TaskDescription) -> str:
        """What a refusal depended on: it stands until one of these changes."""
        return f"{task.identity} {task.generation} {self._catalogue.tip} {self._main.policy_text}"

    def _compose(self, tasks: list[TaskDescription]) -> Desired:
        machines = fleet(self._settings.agents, self._cluster.nodes())
        present: Mapping[str, Release] = self._main.tree.releases
        world = World(self._catalogue.catalogue, machines, present, self._render, self._validate)
        demands = initial_demands(self._catalogue.catalogue, self._main.policy, machines)
        demands += [Demand(task.key, task.application, task.parameters, task=task) for task in tasks]
        return compose(demands, world)

    def _in_doubt(self, desired: Desired) -> dict[str, Release]:
        """Releases on main of demands that are refused for want of evidence only: what runs is not taken away because
        a policy, a key or an envelope changed, but it is not changed either."""
        refused = {k for k, o in desired.outcomes.items() if isinstance(o, Refused) and o.reason in DOUBTS}
        agents = {k.split("/")[2] for k in refused if k.startswith("initial/")}
        namespaces = {agent.namespace for agent in self._settings.agents if agent.name in agents}
        return {
            path: release
            for path, release in self._main.tree.releases.items()
            if any(c.task in refused for c in release.causes)
            or (not release.causes and release.namespace in namespaces)
        }

    def _say_refusals(self) -> None:
        """Refusals of the initial configuration have no task whose status could say them."""
        refused = {
            k: o for k, o in self.desired.outcomes.items() if isinstance(o, Refused) and k.startswith("initial/")
        }
        for key, outcome in refused.items():
            if key not in self._said:
                log.error("initial demand refused demand=%s reason=%s text=%r", key, outcome.reason, outcome.message)
        self._said = frozenset(refused)

    def accepted(self) -> None:
        """The gate took a plan: tasks may be answered together again."""
        self._tasks_per_plan = TASKS_PER_PLAN_MAX

    def refused(self, plan: Plan, record: PlanRecord) -> None:
        """Hold what the gate refused until its inputs change. New tasks refused together are tried one by one, so that
        one of them cannot hold the others."""
        new = {task.key: task for task in self._new()}
        suspects = [key for key in record.tasks if key in new]
        if len(suspects) > 1:
            self._tasks_per_plan = 1
            return
        self._tasks_per_plan = TASKS_PER_PLAN_MAX
        if suspects:
            self._held[suspects[0]] = (self._inputs(new[suspects[0]]), record)
        else:
            self._held_differences[plan.fingerprint] = record
        while len(self._held_differences) > HELD_MAX:
            self._held_differences.pop(next(iter(self._held_differences)))
