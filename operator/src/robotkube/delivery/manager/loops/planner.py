"""From the tasks to the next plan: which demands stand, how they are met, and what the gate refused before."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from robotkube.delivery.deployment.core.commit_messages import NODE, REVERTS_MAX
from robotkube.delivery.deployment.core.releases import Cause, Release, Tree
from robotkube.delivery.manager.core.composition.composer import (
    Composition,
    Demand,
    Inputs,
    Memo,
    Met,
    Refused,
    Validate,
    compose,
)
from robotkube.delivery.manager.core.composition.initial_demands import initial_demands
from robotkube.delivery.manager.core.conflicts import DemandOutcome, History, Postponed, Resolution, resolve
from robotkube.delivery.manager.core.explanations import Explanation, explain
from robotkube.delivery.manager.core.placement.placement import (
    NODE_LOST_SECONDS,
    Agent,
    Fleet,
    NodeState,
    fleet,
    next_loss_ns,
)
from robotkube.delivery.manager.core.placement.scopes import Operators
from robotkube.delivery.manager.core.plans import Change, Plan, differences, fingerprint, lost_words, make_plan
from robotkube.delivery.manager.core.updates import Pin
from robotkube.delivery.manager.loops.constraints import Constraints
from robotkube.delivery.manager.loops.demand_ledger import DemandLedger
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.manager.loops.updates import UpdatePlanner
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.core.holds import DeviceHold
from robotkube.delivery.tasks.core.task_description import POSTPONED, TaskDescription
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.kubernetes.core.objects import object_key
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue

TASKS_PER_PLAN_MAX = 100
HELD_MAX = 1000
UNDECIDED = Refused(POSTPONED, "other pre-emptions are decided first; ask again")
DOUBTS = frozenset({"NoVerifiedVersion", "GuaranteeNotMet"})

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ManagerSettings:
    """`agents` as declared, all of them; `charts_url` is oci://host/organisation; `operators` is the manager's scope
    with the narrower ones of operators; a node not ready for longer than `node_lost_seconds` is lost."""

    agents: tuple[Agent, ...]
    charts_url: str
    operators: Operators = field(default_factory=Operators)
    node_lost_seconds: float = NODE_LOST_SECONDS


class Planner:
    """Computes plans; remembers only what was decided about tasks that are there, and what the gate refused, until the
    inputs of that change. `plan` and the like belong to one thread, `what_if` may be called from any."""

    def __init__(
        self,
        settings: ManagerSettings,
        tasks: TaskStore,
        cluster: Cluster,
        catalogue: AssuredCatalogue,
        main: MainReader,
        render: Render,
        validate: Validate,
        holds: Callable[[], Sequence[DeviceHold]] = tuple,
    ) -> None:
        """`holds` are vetoes that devices say by message; those on Nodes are seen in the cluster."""
        self._settings, self._store, self._cluster, self._holds = settings, tasks, cluster, holds
        self._bounds = Constraints(settings.agents, settings.operators)
        self._catalogue, self._main, self._render, self._validate = catalogue, main, render, validate
        self._ledger, self._lock, self._memo = DemandLedger(), threading.Lock(), Memo()
        self._updating = UpdatePlanner(main.repository, cluster)
        self._machines: tuple[tuple[NodeState, ...], int, int, Fleet] | None = None
        self._tasks_per_plan = TASKS_PER_PLAN_MAX
        self._held: dict[str, tuple[str, PlanRecord]] = {}
        self._held_differences: dict[str, PlanRecord] = {}
        self._said: frozenset[str] = frozenset()
        self._turn = 0
        self._now_ns = 0
        self._told: tuple[Tree, Sequence[Cause], frozenset[str]] = Tree({}, {}), (), frozenset()
        self._demands: dict[str, Demand] = {}
        self._looked_at: list[TaskDescription] = []
        self.desired = Composition({}, {})
        self.outcomes: Mapping[str, DemandOutcome] = {}
        self.tasks: Mapping[str, TaskDescription] = {}
        self.next_due_ns: int | None = None

    @property
    def agents(self) -> Sequence[Agent]:
        """All that are declared."""
        return self._settings.agents

    @property
    def foreign(self) -> frozenset[str]:
        """Namespaces of agents outside the manager's scope."""
        covers = self._settings.operators.manager.covers_agent
        return frozenset(agent.namespace for agent in self._settings.agents if not covers(agent.name))

    @property
    def waiting(self) -> Mapping[str, str]:
        """Tasks with changes on agents that hold them, with agent, reason and end."""
        return self._bounds.waiting_tasks

    @property
    def offloaded(self) -> frozenset[str]:
        """Tasks that run elsewhere than their applications say."""
        return self._ledger.offloaded

    @property
    def held(self) -> Mapping[str, PlanRecord]:
        """Tasks whose plan the gate refused, with that plan."""
        return {key: record for key, (_, record) in self._held.items()}

    def plan(self, started_ns: int) -> Plan | None:
        """The plan that brings main to what is wanted at `started_ns` (ns since 1970); None when it is there or when
        the gate refused exactly this. `next_due_ns` says when time alone changes what is wanted (None: never)."""
        with self._lock:
            self._now_ns = started_ns
            self.tasks = self._ledger.look(self._store.tasks(), started_ns).live
            answered = self._answered()
            self._looked_at = self._wanted(answered)
            self._look_for_updates()
            resolution = self._resolve(self._looked_at, self._ledger.history(self._causes()))
            self._ledger.keep(resolution)
            self._take(resolution)
            changes = self._going(self._changes(resolution.desired))
            waits = bool(changes) and not self._is_held(changes)
            update = self._update(resolution.desired, waits)
            return update or (self._made(changes, self.desired, self.tasks) if waits else None)

    def _look_for_updates(self) -> None:
        """Which versions main's releases keep this time, and whether one chart may be updated or taken back."""
        present, machines = self._bounds.own(self._main.tree).releases, self._fleet()
        held = {hold.agent for hold in self._all_holds()}
        self._updating.look(present, self._main.tip, self._catalogue, machines, held, self._now_ns)

    def _update(self, steady: Composition, others_wait: bool) -> Plan | None:
        """The plan of one update or revert, when it may be made now."""

        def with_pins(pins: Mapping[str, Pin]) -> Composition:
            return self._resolve(self._looked_at, self._ledger.history(self._causes()), pins).desired

        own = self._bounds.own(self._main.tree).releases
        found = self._updating.step(steady, own, others_wait, with_pins)
        changes = self._going(found[1]) if found else ()
        if found is None or not changes or self._is_held(changes):
            return None
        plan, move = self._made(changes, self.desired, self.tasks, found[0].cause, found[0].reason), found[0]
        return replace(plan, message=replace(plan.message, causes=(), reverts=move.undone[-REVERTS_MAX:]))

    def what_if(self, document: Mapping[str, Any]) -> Explanation:
        """What would become of a TaskDescription (a new one, or one in place of that of its name) beside what was
        decided last, without any effect. Times that the document lacks are those of the last plan."""
        with self._lock:
            key, task = object_key(document), self._ledger.foresee(document, self._now_ns)
            if isinstance(task, Refused):
                return explain(key, task, {}, None, self._main.tree)
            history = self._ledger.history(self._causes()).without(key)
            tasks = [*(known for known in self._looked_at if known.key != key), task]
            resolution = self._resolve(tasks, history)
            others = {
                other: (self.outcomes.get(other), outcome)
                for other, outcome in resolution.outcomes.items()
                if other != key and type(outcome) is not type(self.outcomes.get(other))
            }
            changes = self._changes(resolution.desired, remember=False)
            outcome = resolution.outcomes.get(key, UNDECIDED)
            plan = self._difference(changes, resolution.desired, {**self.tasks, key: task})
            waits = self._bounds.waits(changes, self._all_holds(), self._now_ns).get(key, "")
            return explain(key, outcome, others, plan, self._main.tree, waits)

    def _difference(
        self, wanted: Sequence[Change], desired: Composition, tasks: Mapping[str, TaskDescription]
    ) -> Plan | None:
        """What of the changes `wanted` by `desired` is not going to be made anyway."""
        coming = {change.path: change for change in self._changes(self.desired, remember=False)}
        changes = tuple(change for change in wanted if coming.get(change.path) != change)
        return self._made(changes, desired, tasks) if changes else None

    def _take(self, resolution: Resolution) -> None:
        held = {key: Met((), ("accepted, but the gate refused the plan",)) for key in self._held}
        initial = {k: o for k, o in resolution.outcomes.items() if k not in self.tasks}
        self.outcomes = {**initial, **self._ledger.outcomes, **held}
        told = {key: _told(outcome) for key, outcome in self.outcomes.items()}
        self.desired = replace(resolution.desired, outcomes=told)
        times = [self._ledger.standing.next_due_ns, resolution.next_due_ns, self._now_ns if resolution.left else None]
        times.append(next_loss_ns(self._cluster.nodes(), self._settings.node_lost_seconds, self._now_ns))
        self.next_due_ns = min((time for time in times if time is not None), default=None)
        self._say_refusals()

    def _changes(self, desired: Composition, remember: bool = True) -> tuple[Change, ...]:
        """What main lacks of `desired`; `remember` as in MainReader.respected."""
        own = self._bounds.own(self._main.tree).releases
        in_doubt = {path: release for path, release in self._in_doubt(desired).items() if path in own}
        return self._main.respected(differences({**in_doubt, **desired.releases}, own), remember)

    def _going(self, changes: tuple[Change, ...]) -> tuple[Change, ...]:
        """The changes that no device holds; the others go on when the first hold ends, or when it is released."""
        going = self._bounds.going(changes, self._all_holds(), self._now_ns)
        times = [self.next_due_ns, self._bounds.holds_end_ns]
        self.next_due_ns = min((time for time in times if time is not None), default=None)
        return going

    def _is_held(self, changes: tuple[Change, ...]) -> bool:
        """Whether the gate refused exactly this before."""
        return bool(self._held_differences) and fingerprint(changes) in self._held_differences

    def _all_holds(self) -> Sequence[DeviceHold]:
        """The vetoes on Nodes, and those said by message."""
        said = [node.hold for node in self._cluster.nodes() if node.hold is not None]
        return [*said, *self._holds()]

    def _made(
        self,
        changes: tuple[Change, ...],
        desired: Composition,
        tasks: Mapping[str, TaskDescription],
        cause: str = "",
        words: str = "",
    ) -> Plan:
        stamp = datetime.fromtimestamp(self._now_ns / 1e9, UTC).strftime("%Y%m%d-%H%M%S")
        catalogue, url = self._catalogue.catalogue, self._settings.charts_url
        words = words or lost_words(changes, self._fleet(), self._now_ns)
        own, cause = self._bounds.own(self._main.tree), cause or (NODE if words else "")
        return make_plan(changes, own, desired, tasks, catalogue, url, self._main.tip, stamp, cause, words)

    def _answered(self) -> frozenset[str]:
        """Tasks that main answers; looked up once per main."""
        self._causes()
        return self._told[2]

    def _causes(self) -> Sequence[Cause]:
        """The causes of main's releases; looked up once per main."""
        tree = self._main.tree
        if self._told[0] is not tree:
            causes = [cause for release in tree.releases.values() for cause in release.causes]
            self._told = tree, causes, frozenset(cause.task for cause in causes)
        return self._told[1]

    def _wanted(self, answered: frozenset[str]) -> list[TaskDescription]:
        """The tasks of this plan: all that main answers, the new ones of the highest priority that are not held, and in
        turns those that were not met the last time."""
        tasks = self.tasks
        self._held = {k: held for k, held in self._held.items() if k in tasks and held[0] == self._inputs(tasks[k])}
        standing = [task for task in tasks.values() if task.key in answered and task.key not in self._held]
        new = [task for task in tasks.values() if task.key not in answered and task.key not in self._held]
        fresh, again = self._ledger.split(sorted(new, key=lambda t: (-t.priority, t.created, t.key)))
        fresh = fresh[: self._tasks_per_plan]
        places = TASKS_PER_PLAN_MAX if self._tasks_per_plan > 1 else 1 - len(fresh)
        turn = self._turn % len(again) if len(again) > places else 0
        self._turn = turn + places
        return [*standing, *fresh, *[*again[turn:], *again[:turn]][:places]]

    def _inputs(self, task: TaskDescription) -> str:
        """What a refusal depended on: it stands until one of these changes."""
        return f"{task.identity} {task.generation} {self._catalogue.tip} {self._main.policy_text}"

    def _resolve(
        self, tasks: Sequence[TaskDescription], history: History, pins: Mapping[str, Pin] | None = None
    ) -> Resolution:
        """What the initial configuration and the tasks lead to within the manager's bounds, besides what main holds
        now; changes nothing here. `pins` are the versions that releases keep (None: those of main). Every round leaves
        out tasks that the one before showed to be out of bounds."""
        live = {**self.tasks, **{task.key: task for task in tasks}}
        looked_at, releases = {task.key for task in tasks}, tuple(self._main.tree.releases.values())
        gone = _gone({k: o for k, o in self._ledger.outcomes.items() if k not in looked_at})
        refused = self._bounds.refused_before(tasks, live, gone, releases)
        for _ in range(len(tasks) + 1):
            inside = [task for task in tasks if task.key not in refused]
            resolution = self._within(inside, history, self._updating.updates.pins if pins is None else pins)
            now_gone = {**gone, **_gone({**resolution.outcomes, **refused})}
            found = self._bounds.refused_after(inside, live, now_gone, releases, resolution.outcomes)
            if not found:
                break
            refused |= found
        return replace(resolution, outcomes={**resolution.outcomes, **refused})

    def _within(self, tasks: Sequence[TaskDescription], history: History, pins: Mapping[str, Pin]) -> Resolution:
        machines, tree = self._bounds.fleet(self._fleet()), self._main.tree
        present: Mapping[str, Release] = self._bounds.own(tree).releases
        inputs = Inputs(
            self._catalogue.catalogue,
            machines,
            present,
            self._render,
            self._validate,
            others={} if present is tree.releases else _without(tree.releases, present),
            pins=pins,
            withheld=self._updating.updates.withheld,
            schema=self._catalogue.schema,
        )
        initial = initial_demands(self._catalogue.catalogue, self._main.policy, machines)
        wanted = [*initial, *self._demands_of(tasks)]
        return resolve(wanted, lambda demands: compose(demands, inputs, self._memo), history, self._now_ns)

    def _demands_of(self, tasks: Sequence[TaskDescription]) -> list[Demand]:
        """A demand for each task; the same object as long as the task is the same."""
        known = self._demands
        demands = [
            found if (found := known.get(task.key)) is not None and found.task is task else _demand(task)
            for task in tasks
        ]
        self._demands = {demand.key: demand for demand in demands}
        return demands

    def _fleet(self) -> Fleet:
        """All agents with their nodes; those that are lost by now are marked."""
        nodes, now_ns, seconds = tuple(self._cluster.nodes()), self._now_ns, self._settings.node_lost_seconds
        known = self._machines
        if known is None or known[0] != nodes or not known[1] <= now_ns < known[2]:
            until_ns = next_loss_ns(nodes, seconds, now_ns) or sys.maxsize
            known = (nodes, now_ns, until_ns, fleet(self._settings.agents, nodes, now_ns, seconds))
            self._machines = known
        return known[3]

    def _in_doubt(self, desired: Composition) -> dict[str, Release]:
        """Releases on main of demands that are refused for want of evidence only: what runs is not taken away because
        a policy, a key or an envelope changed, but it is not changed either."""
        refused = {k for k, o in desired.outcomes.items() if isinstance(o, Refused) and o.reason in DOUBTS}
        if not refused:
            return {}
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
        answered = self._answered()
        new = {key: task for key, task in self.tasks.items() if key not in answered}
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


def _demand(task: TaskDescription) -> Demand:
    return Demand(task.key, task.application, task.parameters, task=task)


def _without(releases: Mapping[str, Release], own: Mapping[str, Release]) -> dict[str, Release]:
    return {path: release for path, release in releases.items() if path not in own}


def _gone(outcomes: Mapping[str, DemandOutcome]) -> dict[str, str]:
    """Demands that are not met, with why; what runs on in doubt is not gone."""
    return {
        key: f"{outcome.reason}: {outcome.message}"
        for key, outcome in outcomes.items()
        if not isinstance(outcome, Met) and outcome.reason not in DOUBTS
    }


def _told(outcome: DemandOutcome) -> Met | Refused:
    """As the pull request says it: a demand that waits is not met."""
    return Refused(POSTPONED, outcome.message) if isinstance(outcome, Postponed) else outcome
