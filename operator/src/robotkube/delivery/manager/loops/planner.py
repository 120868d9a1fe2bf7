"""The planner: it makes the next plan from the tasks, and keeps what the gate refused before."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

from robotkube.delivery.deployment.core.commit_messages import NODE, REPAIR, REVERTS_MAX
from robotkube.delivery.deployment.core.releases import Release, TaskCause, Tree
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
from robotkube.delivery.manager.core.composition.initial_demands import initial_demands, sent_to_others
from robotkube.delivery.manager.core.conflicts import DemandOutcome, History, Postponed, Resolution, resolve
from robotkube.delivery.manager.core.explanations import Explanation, explain, explain_withdrawal
from robotkube.delivery.manager.core.placement.placement import (
    NODE_LOST_SECONDS,
    Agent,
    Fleet,
    NodeState,
    fleet,
    next_loss_ns,
)
from robotkube.delivery.manager.core.placement.scopes import Operators
from robotkube.delivery.manager.core.plans import (
    Change,
    Plan,
    describe,
    differences,
    fingerprint,
    lost_node_text,
    make_plan,
)
from robotkube.delivery.manager.core.standing_demands import Asked
from robotkube.delivery.manager.core.standing_evidence import EVIDENCE_REASONS, with_doubtful
from robotkube.delivery.manager.core.updates.memory import Pin
from robotkube.delivery.manager.loops.constraints import Constraints
from robotkube.delivery.manager.loops.demand_ledger import DemandLedger
from robotkube.delivery.manager.loops.initial_refusals import InitialRefusals
from robotkube.delivery.manager.loops.main_reader import MainReader
from robotkube.delivery.manager.loops.memo_of_valid import MemoOfValid
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.manager.loops.proposals.refused_plans import RefusedPlans
from robotkube.delivery.manager.loops.updates.update_planner import UpdatePlanner
from robotkube.delivery.manager.loops.verified_images import INITIAL, ImageRefusals, VerifiedImages, blamed
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.core.holds import DeviceHold
from robotkube.delivery.tasks.core.task_description import POSTPONED, TaskDescription
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.documents.core.value_templates import Render
from robotkube.foundation.kubernetes.core.objects import object_key
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue, read_policy

TASKS_PER_PLAN_MAX = 100
REFUSED_PLANS_MAX = 10  # in one step, for the images that they would run
UNDECIDED = Refused(POSTPONED, "other pre-emptions are decided first; ask again")


@dataclass(frozen=True)
class ManagerSettings:
    """What a manager is set up with: `agents` as declared, also reserved ones; `charts_url` is oci://host/organisation;
    `operators` is the manager's scope with the narrower ones of operators; a node not ready for longer than
    `node_lost_seconds` is lost."""

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
        images: VerifiedImages | None = None,
        settled: Callable[[], bool] = lambda: True,
    ) -> None:
        """`holds` are those that devices report by message; those on Nodes are read from the cluster. `images` looks up
        what releases would run. `validate` and `settled` belong together: see MemoOfValid."""
        self._settings = settings
        self._store = tasks
        self._cluster = cluster
        self._holds = holds
        self._constraints = Constraints(settings.agents, settings.operators)
        self._catalogue = catalogue
        self._main = main
        self._render = render
        self._validate = validate
        self._images = images or VerifiedImages(None)
        self._image_refusals = ImageRefusals()
        self._ledger = DemandLedger()
        self._lock = threading.Lock()
        self._memo = MemoOfValid(settled)
        self.updating = UpdatePlanner(main.repository, cluster, main.notes)
        self._known_fleet: tuple[Sequence[Agent], tuple[NodeState, ...], int, int, Fleet] | None = None
        self._tasks_per_plan = TASKS_PER_PLAN_MAX
        self.refused_plans = RefusedPlans()
        self._initial_refusals = InitialRefusals()
        self._turn = 0
        self._now_ns = 0
        self._main_causes: tuple[Tree, Sequence[TaskCause]] = Tree({}, {}), ()
        self._demands: dict[str, Demand] = {}
        self._planned_tasks: list[TaskDescription] = []
        self.desired = Composition({}, {})
        self.outcomes: Mapping[str, DemandOutcome] = {}
        self.decided: Mapping[str, Asked] = {}
        self.tasks: Mapping[str, TaskDescription] = {}
        self.next_due_ns: int | None = None

    @property
    def agents(self) -> Sequence[Agent]:
        """The declared agents that are there, as main says."""
        return self._constraints.agents(self._main.enrolled)

    @property
    def foreign(self) -> frozenset[str]:
        """Namespaces of agents outside the manager's scope."""
        covers = self._settings.operators.manager.covers_agent
        return frozenset(agent.namespace for agent in self._settings.agents if not covers(agent.name))

    @property
    def waiting(self) -> Mapping[str, str]:
        """Tasks with changes on agents that hold them, with agent, reason and end."""
        return self._constraints.waiting_tasks

    @property
    def offloaded(self) -> frozenset[str]:
        """Tasks that run elsewhere than their applications say."""
        return self._ledger.offloaded

    @property
    def held(self) -> Mapping[str, PlanRecord]:
        """Tasks whose plan the gate refused, with that plan."""
        return self.refused_plans.tasks

    def plan(self, started_ns: int) -> Plan | None:
        """The plan that brings main to what is wanted at `started_ns` (ns since 1970); None when it is there or when
        the gate refused exactly this. `next_due_ns` says when time alone changes what is wanted (None: never)."""
        with self._lock:
            self._now_ns = started_ns
            self.tasks = self._ledger.read(self._store.tasks(), started_ns).live
            answered = self._answered()
            self._planned_tasks = self._wanted(answered)
            self._decide_updates()
            resolution = self._resolve(self._planned_tasks, self._ledger.history(self._causes()))
            self._ledger.keep(resolution)
            self._adopt(resolution)
            changes = self._unheld(self._changes(resolution.desired))
            waits = bool(changes) and not self._is_held(changes)
            update = self._update(resolution.desired, waits)
            return update or (self._make_plan(changes, self.desired, self.tasks) if waits else None)

    def _decide_updates(self) -> None:
        """Decide which versions main's releases keep this time, and whether one chart may be updated or reverted."""
        present = self._constraints.own(self._main.tree).releases
        held = {hold.agent for hold in self._all_holds()}
        self.updating.decide(present, self._main.tip, self._catalogue, self._fleet(), held, self._now_ns)

    def _update(self, steady: Composition, others_wait: bool) -> Plan | None:
        """The plan of one update or revert, when it may be made now."""

        def with_pins(pins: Mapping[str, Pin]) -> Composition:
            return self._resolve(self._planned_tasks, self._ledger.history(self._causes()), pins).desired

        own = self._constraints.own(self._main.tree).releases
        step = self.updating.step(steady, own, others_wait, with_pins)
        if step is None:
            return None
        move = step[0]
        changes = self._unheld(step[1])
        if not changes or self._is_held(changes):
            return None
        if problems := self._images.problems(changes, self._catalogue.catalogue):
            self.updating.unfit(move, "; ".join(f"release {key}: {text}" for key, text in problems.items()))
            return None
        plan = self._make_plan(changes, self.desired, self.tasks, move.cause, move.reason)
        return replace(plan, message=replace(plan.message, causes=(), reverts=move.undone[-REVERTS_MAX:]))

    def verified(self, decide: Callable[[], Plan | None]) -> Plan | None:
        """The plan that `decide` gives, when its releases would run what was verified with their charts; else demands
        that lead to other images are refused, and it decides again. After REFUSED_PLANS_MAX plans the next step goes
        on."""
        for _ in range(REFUSED_PLANS_MAX):
            plan = decide()
            if plan is None or not self._refuse_unverified(plan):
                return plan
        self.next_due_ns = self._now_ns
        return None

    def _refuse_unverified(self, plan: Plan) -> bool:
        """Refuse the demands whose releases in the plan would run other images; whether there are any. A repair only
        brings back what main had."""
        if REPAIR in plan.message.kinds:
            return False
        with self._lock:
            problems = self._images.problems(plan.changes, self._catalogue.catalogue)
            refused = blamed(problems, self.desired.outcomes, self._main.tree.releases) if problems else {}
            self._image_refusals.add(refused, self._inputs_of)
            return bool(refused)

    def describe(self, plan: Plan) -> str:
        """The pull request's body."""
        policy, _ = read_policy(self._catalogue.files)
        suites = [rule.name for rule in policy.suites] if policy else []
        return describe(plan, self.desired, self.tasks, self._catalogue.catalogue, suites)

    def what_if(self, document: Mapping[str, Any] | str) -> Explanation:
        """Explain what would become of a TaskDescription (a new one, or one in place of that of its name) beside what
        was decided last, or of everything else without the task of a key; no effect. Times that the document lacks are
        those of the last plan."""
        with self._lock:
            if isinstance(document, str):
                return self._what_without(document)
            key = object_key(document)
            task = self._ledger.foresee(document, self._now_ns)
            if isinstance(task, Refused):
                return explain(key, task, {}, None, self._main.tree)
            history = self._ledger.history(self._causes()).without(key)
            tasks = [*(known for known in self._planned_tasks if known.key != key), task]
            resolution = self._resolve(tasks, history)
            others = self._faring_otherwise(resolution, key)
            changes = self._changes(resolution.desired, remember=False)
            outcome = resolution.outcomes.get(key, UNDECIDED)
            plan = self._difference(changes, resolution.desired, {**self.tasks, key: task})
            refusal = self._unverified(key, outcome, plan)
            outcome, plan = (refusal, None) if refusal else (outcome, plan)
            waits = self._constraints.waits(changes, self._all_holds(), self._now_ns).get(key, "")
            return explain(key, outcome, others, plan, self._main.tree, waits)

    def _what_without(self, key: str) -> Explanation:
        """Explain what would become of everything else when a task is withdrawn."""
        left = {other: task for other, task in self.tasks.items() if other != key}
        tasks = [task for task in self._planned_tasks if task.key != key]
        resolution = self._resolve(tasks, self._ledger.history(self._causes()).without(key), live=left)
        changes = self._changes(resolution.desired, remember=False)
        plan = self._difference(changes, resolution.desired, left)
        waits = self._constraints.waits(changes, self._all_holds(), self._now_ns).get(key, "")
        return explain_withdrawal(key, self._faring_otherwise(resolution, key), plan, self._main.tree, waits)

    def _faring_otherwise(
        self, resolution: Resolution, key: str
    ) -> dict[str, tuple[DemandOutcome | None, DemandOutcome]]:
        """The demands beside one whose outcomes are others than those decided last: both outcomes."""
        return {
            other: (self.outcomes.get(other), outcome)
            for other, outcome in resolution.outcomes.items()
            if other != key and type(outcome) is not type(self.outcomes.get(other))
        }

    def _unverified(self, key: str, outcome: DemandOutcome, plan: Plan | None) -> Refused | None:
        """The refusal of a demand for the images of its releases in a plan; None when there is none."""
        if plan is None:
            return None
        problems = self._images.problems(plan.changes, self._catalogue.catalogue)
        return blamed(problems, {key: outcome}, {}).get(key)

    def _difference(
        self, wanted: Sequence[Change], desired: Composition, tasks: Mapping[str, TaskDescription]
    ) -> Plan | None:
        """The plan of the changes `wanted` by `desired` that are not going to be made anyway; None when there are
        none."""
        coming = {change.path: change for change in self._changes(self.desired, remember=False)}
        changes = tuple(change for change in wanted if coming.get(change.path) != change)
        return self._make_plan(changes, desired, tasks) if changes else None

    def _adopt(self, resolution: Resolution) -> None:
        """Keep a resolution as what was decided last, and when time alone changes it."""
        held = {key: Met((), ("accepted, but the gate refused the plan",)) for key in self.held}
        initial = {k: o for k, o in resolution.outcomes.items() if k not in self.tasks}
        self.outcomes = {**initial, **self._ledger.outcomes, **held}
        self.decided = self._ledger.asked()
        described = {key: _met_or_refused(outcome) for key, outcome in self.outcomes.items()}
        self.desired = replace(resolution.desired, outcomes=described)
        times = [
            self._ledger.demands.next_due_ns,
            resolution.next_due_ns,
            self._now_ns if resolution.undecided else None,
        ]
        times.append(next_loss_ns(self._cluster.nodes(), self._settings.node_lost_seconds, self._now_ns))
        self.next_due_ns = min((time for time in times if time is not None), default=None)
        self._initial_refusals.report(self.desired.outcomes)

    def _changes(self, desired: Composition, remember: bool = True) -> tuple[Change, ...]:
        """The changes that bring main to `desired`; `remember` as in MainReader.respected."""
        own = self._constraints.own(self._main.tree).releases
        wanted = with_doubtful(desired, self._main.tree.releases, own, self._settings.agents)
        return self._main.respected(differences(wanted, own), remember)

    def _unheld(self, changes: tuple[Change, ...]) -> tuple[Change, ...]:
        """The changes that no device holds; the others go on when the first hold ends, or when it is released."""
        unheld = self._constraints.unheld(changes, self._all_holds(), self._now_ns)
        times = [self.next_due_ns, self._constraints.holds_end_ns]
        self.next_due_ns = min((time for time in times if time is not None), default=None)
        return unheld

    def _is_held(self, changes: tuple[Change, ...]) -> bool:
        """Return whether the gate refused exactly this before."""
        return self.refused_plans.holds(lambda: fingerprint(changes))

    def _all_holds(self) -> Sequence[DeviceHold]:
        """The holds on Nodes, and those reported by message."""
        on_nodes = [node.hold for node in self._cluster.nodes() if node.hold is not None]
        return [*on_nodes, *self._holds()]

    def _make_plan(
        self,
        changes: tuple[Change, ...],
        desired: Composition,
        tasks: Mapping[str, TaskDescription],
        cause: str = "",
        reason: str = "",
    ) -> Plan:
        stamp = datetime.fromtimestamp(self._now_ns / 1e9, UTC).strftime("%Y%m%d-%H%M%S")
        catalogue = self._catalogue.catalogue
        url = self._settings.charts_url
        reason = reason or lost_node_text(changes, self._fleet(), self._now_ns)
        cause = cause or (NODE if reason else "")
        own = self._constraints.own(self._main.tree)
        return make_plan(changes, own, desired, tasks, catalogue, url, self._main.tip, stamp, cause, reason)

    def _answered(self) -> frozenset[str]:
        """Tasks that main answers; looked up once per main."""
        return self._ledger.answered(self._causes())

    def _causes(self) -> Sequence[TaskCause]:
        """The causes of main's releases; looked up once per main."""
        tree = self._main.tree
        if self._main_causes[0] is not tree:
            self._main_causes = tree, [cause for release in tree.releases.values() for cause in release.causes]
        return self._main_causes[1]

    def _wanted(self, answered: frozenset[str]) -> list[TaskDescription]:
        """The tasks of this plan: all that main answers, the new ones of the highest priority that are not held, and in
        turns those that were not met the last time."""
        tasks = self.tasks
        self.refused_plans.keep(self._inputs_of)
        held = self.held
        standing = [task for task in tasks.values() if task.key in answered and task.key not in held]
        new = [task for task in tasks.values() if task.key not in answered and task.key not in held]
        fresh, again = self._ledger.split(sorted(new, key=lambda t: (-t.priority, t.created, t.key)))
        fresh = fresh[: self._tasks_per_plan]
        places = TASKS_PER_PLAN_MAX if self._tasks_per_plan > 1 else 1 - len(fresh)
        turn = self._turn % len(again) if len(again) > places else 0
        self._turn = turn + places
        return [*standing, *fresh, *[*again[turn:], *again[:turn]][:places]]

    def _inputs(self, task: TaskDescription) -> str:
        """The inputs of a refusal, as text: it stands until one of them changes."""
        return f"{task.identity} {task.generation} {self._inputs_of_all}"

    @property
    def _inputs_of_all(self) -> str:
        return f"{self._catalogue.tip} {self._main.policy_text} {self._main.consents}"

    def _inputs_of(self, key: str) -> str | None:
        """The inputs of a refusal of the demand `key`; None when its task is gone."""
        if key.startswith(INITIAL):
            return self._inputs_of_all
        return self._inputs(self.tasks[key]) if key in self.tasks else None

    def _resolve(
        self,
        tasks: Sequence[TaskDescription],
        history: History,
        pins: Mapping[str, Pin] | None = None,
        live: Mapping[str, TaskDescription] | None = None,
    ) -> Resolution:
        """The resolution of the initial configuration and the tasks within the manager's constraints, besides what main
        holds now; changes nothing here. `pins` are the versions that releases keep (None: those of main), `live` the
        tasks that are there (None: all). Every round leaves out tasks that the one before showed to be outside of
        them."""
        live = {**(self.tasks if live is None else live), **{task.key: task for task in tasks}}
        keys = {task.key for task in tasks}
        releases = tuple(self._main.tree.releases.values())
        gone = _gone({k: o for k, o in self._ledger.outcomes.items() if k not in keys})
        refused = self._constraints.refused_before(tasks, live, gone, releases)
        for _ in range(len(tasks) + 1):
            inside = [task for task in tasks if task.key not in refused]
            resolution = self._within(inside, history, self.updating.updates.pins if pins is None else pins)
            now_gone = {**gone, **_gone({**resolution.outcomes, **refused})}
            refusals = self._constraints.refused_after(inside, live, now_gone, releases, resolution.outcomes)
            if not refusals:
                break
            refused |= refusals
        return replace(resolution, outcomes={**resolution.outcomes, **refused})

    def _within(self, tasks: Sequence[TaskDescription], history: History, pins: Mapping[str, Pin]) -> Resolution:
        own_fleet = self._constraints.fleet(self._fleet(), self._main.consents)
        tree = self._main.tree
        present: Mapping[str, Release] = self._constraints.own(tree).releases
        inputs = Inputs(
            self._catalogue.catalogue,
            own_fleet,
            present,
            self._render,
            self._validate,
            others={} if present is tree.releases else _without(tree.releases, present),
            pins=pins,
            withheld=self.updating.updates.withheld,
            schema=self._catalogue.schema,
        )
        initial = initial_demands(self._catalogue.catalogue, self._main.policy, own_fleet)
        wanted = [*initial, *sent_to_others(inputs.others, own_fleet), *self._demands_of(tasks)]
        refused = self._image_refusals.standing(self._inputs_of)

        def composed(memo: Memo, demands: Sequence[Demand]) -> Composition:
            if not refused:
                return compose(demands, inputs, memo)
            composition = compose([demand for demand in demands if demand.key not in refused], inputs, memo)
            left_out = {demand.key: refused[demand.key] for demand in demands if demand.key in refused}
            return replace(composition, outcomes={**composition.outcomes, **left_out})

        return self._memo.used(lambda memo: resolve(wanted, partial(composed, memo), history, self._now_ns))

    def _demands_of(self, tasks: Sequence[TaskDescription]) -> list[Demand]:
        """A demand for each task; the same object as long as the task is the same."""
        known = self._demands
        demands = [
            demand if (demand := known.get(task.key)) is not None and demand.task is task else _demand(task)
            for task in tasks
        ]
        self._demands = {demand.key: demand for demand in demands}
        return demands

    def _fleet(self) -> Fleet:
        """All agents that are there, with their nodes; those that are lost by now are marked."""
        nodes = tuple(self._cluster.nodes())
        now_ns = self._now_ns
        seconds = self._settings.node_lost_seconds
        agents = self.agents
        known = self._known_fleet
        if known is None or known[0] is not agents or known[1] != nodes or not known[2] <= now_ns < known[3]:
            until_ns = next_loss_ns(nodes, seconds, now_ns) or sys.maxsize
            known = (agents, nodes, now_ns, until_ns, fleet(agents, nodes, now_ns, seconds))
            self._known_fleet = known
        return known[4]

    def accepted(self) -> None:
        """Note that the gate accepted a plan: tasks may be answered together again."""
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
            self.refused_plans.hold_task(suspects[0], self._inputs(new[suspects[0]]), record)
        else:
            self.refused_plans.hold_differences(plan.fingerprint, record)


def _demand(task: TaskDescription) -> Demand:
    return Demand(task.key, task.application, task.parameters, task=task)


def _without(releases: Mapping[str, Release], own: Mapping[str, Release]) -> dict[str, Release]:
    return {path: release for path, release in releases.items() if path not in own}


def _gone(outcomes: Mapping[str, DemandOutcome]) -> dict[str, str]:
    """Demands that are not met, with why; what runs on without evidence is not gone."""
    return {
        key: f"{outcome.reason}: {outcome.message}"
        for key, outcome in outcomes.items()
        if not isinstance(outcome, Met) and outcome.reason not in EVIDENCE_REASONS
    }


def _met_or_refused(outcome: DemandOutcome) -> Met | Refused:
    """The outcome as the pull request describes it: a demand that waits is not met."""
    return Refused(POSTPONED, outcome.message) if isinstance(outcome, Postponed) else outcome
