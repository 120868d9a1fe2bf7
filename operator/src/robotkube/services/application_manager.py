"""The application manager: from tasks, nodes and catalogue to proposals, and from merged plans to the tasks' statuses.

Level-triggered and single-threaded: a step reads everything again, computes what should be on main, proposes the
difference, looks at the decision about an earlier proposal and at the cluster. Webhooks and watches only bring the next
step forward; after a restart the next step finds everything in Git, in the tasks and in the cluster. Tasks that arrive
while a proposal waits for its decision are answered together by the next plan.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from robotkube.domain.errors import RefusalError, RobotKubeError, UnavailableError
from robotkube.domain.planning import Plan, describe
from robotkube.ports.clusters import Cluster, TaskStore
from robotkube.ports.forges import Forge
from robotkube.ports.git import DeploymentRepository, Proposals
from robotkube.services.assured_catalogue import AssuredCatalogue, read_policy
from robotkube.services.manager_decisions import Decisions, Proposal
from robotkube.services.manager_observing import PlanObserver
from robotkube.services.manager_planning import Planner
from robotkube.services.manager_reading import MainReader, catalogue_page
from robotkube.services.manager_records import PlanRecord, PlanRecords, record_of, records_of
from robotkube.services.manager_statuses import Situation, StatusWriter

DECISION_POLL_SECONDS = 1.0  # the forge's webhook is the normal way; asking costs the forge what the gate needs
DECISION_EAGER_SECONDS = 5.0
DECISION_POLL_SECONDS_LATER = 2.0
ATTEMPTS_MAX = 10
PAUSE_SECONDS = 5.0
LOOK_SECONDS = 10.0
OBSERVE_POLL_SECONDS = 1.0
FAILURE_SECONDS = 1.0
SILENT_SECONDS_MAX = 30.0
SAID_SECONDS = 15.0  # after so long without the forge the tasks are told
COMMITS_READ_MAX = 200
TASKS, NODES, APPLICATIONS, DEPLOYMENT, CATALOGUE = "tasks", "nodes", "applications", "deployment", "catalogue"
PLANNED_FOR = frozenset({TASKS, NODES, DEPLOYMENT, CATALOGUE})

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class World:
    """The ports that the manager works with."""

    tasks: TaskStore
    cluster: Cluster
    deployment: DeploymentRepository
    proposals: Proposals
    forge: Forge


@dataclass
class ManagerStatistics:
    """Counted since the start."""

    plans: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("proposed", "merged", "refused", "outdated", "observed"), 0)
    )
    steps: int = 0
    failures: int = 0


class ApplicationManager:
    """One manager for one deployment repository; `run` on one thread, `wake` from any.

    `now_ns` is the wall clock in ns since 1970, `monotonic` a clock in seconds that never goes back.
    """

    def __init__(
        self,
        world: World,
        catalogue: AssuredCatalogue,
        main: MainReader,
        planner: Planner,
        observer: PlanObserver,
        now_ns: Callable[[], int],
        monotonic: Callable[[], float],
    ) -> None:
        self._world, self._catalogue, self._main, self._planner = world, catalogue, main, planner
        self._observer, self._now_ns, self._monotonic = observer, now_ns, monotonic
        self._statuses = StatusWriter(world.tasks, now_ns)
        self.statistics = ManagerStatistics()
        self.records = PlanRecords(now_ns())
        self._flags = {TASKS, DEPLOYMENT, CATALOGUE}
        self._lock, self._woken = threading.Lock(), threading.Event()
        self._told_tip = ""
        self._demand_seen: int | None = None
        self._decisions = Decisions(world.deployment, world.forge, monotonic)
        self._proposal: Proposal | None = None
        self._undecided: list[PlanRecord] = []
        self._attempts = 0
        self._not_before = self._looked_at = self._seen_at = float("-inf")
        self._problem = "has not looked at the world yet"

    def catalogue_page(self) -> dict[str, Any]:
        """The document of GET /catalogue."""
        return catalogue_page(self._catalogue.catalogue, self._catalogue.tip)

    # -- waking ---------------------------------------------------------------------------------------------------

    def wake(self, what: str, tip: str = "") -> None:
        """Something may have changed: TASKS, NODES, APPLICATIONS, DEPLOYMENT or CATALOGUE. `tip`: main's new tip when
        the forge said it under its signature, which saves fetching what was proposed from here."""
        with self._lock:
            self._flags.add(what)
            self._told_tip = tip or self._told_tip
            if what in PLANNED_FOR and self._demand_seen is None:
                self._demand_seen = self._now_ns()
        self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the step that is under way."""
        stopping.set()
        self._woken.set()

    def reasons_not_ready(self) -> list[str]:
        """Empty when the forge was seen lately and nothing stops planning."""
        silent = self._monotonic() - self._seen_at
        late = [f"the forge was not seen for {silent:.0f} s"] if SILENT_SECONDS_MAX < silent < float("inf") else []
        return late + ([self._problem] if self._problem else [])

    def run(self, stopping: threading.Event) -> None:
        """Steps until `stopping` is set; errors of the world are logged and met again after a pause."""
        pause = 0.0
        while not stopping.is_set():
            self._woken.wait(pause)
            self._woken.clear()
            try:
                pause = self.step()
            except RobotKubeError as error:
                self._failed(error)
                stopping.wait(FAILURE_SECONDS)
                pause = 0.0

    def _failed(self, error: RobotKubeError) -> None:
        self.statistics.failures += 1
        if self._problem != str(error):
            log.error("step failed reason=%r", str(error))
        self._problem = str(error)
        self._again(DEPLOYMENT, CATALOGUE)
        if isinstance(error, UnavailableError) and self._monotonic() - self._seen_at > SAID_SECONDS:
            self._say_forge_unavailable()

    def _say_forge_unavailable(self) -> None:
        """The statuses are in the cluster, which may well answer while the forge does not."""
        text = "the forge does not answer; the task waits, and goes on when the forge is back"
        try:
            self._statuses.write(replace(self._situation(), forge_unavailable=text))
        except RobotKubeError as error:
            log.error("statuses not written reason=%r", str(error))

    def _again(self, *what: str) -> None:
        """The next step plans again, whatever was seen before."""
        with self._lock:
            self._flags |= {TASKS, *what}

    # -- one step -------------------------------------------------------------------------------------------------

    def step(self) -> float:
        """Look, decide, plan, observe, report; the seconds until the next step is due without being woken."""
        self.statistics.steps += 1
        with self._lock:
            flags, self._flags = self._flags, set()
            told, self._told_tip = self._told_tip, ""
        if self._monotonic() - self._looked_at >= LOOK_SECONDS:
            flags |= {TASKS, DEPLOYMENT, CATALOGUE}
            self._looked_at = self._monotonic()
        self._look(flags, told)
        if self._proposal is not None:
            self._follow(self._proposal)
        if flags & PLANNED_FOR or self._flags & PLANNED_FOR:
            self._plan_if_free()
        for record in self._observer.look(self._main.tree.releases, self._main.tip):
            self._observed(record)
        self._statuses.write(self._situation())
        return self._pause()

    def _pause(self) -> float:
        if self._proposal is not None:
            eager = self._monotonic() - self._proposal.since < DECISION_EAGER_SECONDS
            return DECISION_POLL_SECONDS if eager else DECISION_POLL_SECONDS_LATER
        if self._flags & PLANNED_FOR:
            return min(max(self._not_before - self._monotonic(), 0.0), LOOK_SECONDS)
        return OBSERVE_POLL_SECONDS if self._observer.waiting else LOOK_SECONDS

    def _look(self, flags: set[str], told: str) -> None:
        """Read what may have changed in the two repositories; `told` is main's tip as the forge last told it."""
        if CATALOGUE in flags:
            self._catalogue.read()
        if DEPLOYMENT in flags or self._proposal is not None:
            before = self._main.tip
            own = self._proposal is not None and told == self._proposal.record.commit
            if self._main.read(told if own else ""):
                self._again()
                self._settle_undecided()
                self._remember(before)
        self._seen_at = self._monotonic()

    def _remember(self, since: str) -> None:
        """Plans on main that this process has no record of: after a start, or when an answer of the forge was lost."""
        mine = self._proposal.record.id if self._proposal else ""
        commits = self._world.deployment.log(since or None, COMMITS_READ_MAX)
        unknown = [r for r in records_of(commits) if r.id != mine and not self.records.has_merged(r.id)]
        pulls = {pull.head: pull for pull in self._world.forge.pull_requests("all")} if unknown else {}
        for record in unknown:
            self._decisions.name(record, pulls.get(record.commit))
            self.records.add(record)
            self._observer.watch(record)
        if unknown:
            self._observer.forget_observed(self._main.tree.releases)

    # -- following a proposal ---------------------------------------------------------------------------------------

    def _follow(self, proposal: Proposal) -> None:
        """Merged, outdated, refused, or no decision yet: then it waits as long as it takes, since the gate decides what
        it finds open whenever it comes back."""
        outcome, text = self._decisions.look(proposal, self._main.tip)
        if outcome == "merged":
            self._merged(proposal.record)
            self._proposal, self._attempts = None, 0
            self._planner.accepted()
            self._again()
        elif outcome == "outdated":
            self._outdated(proposal)
        elif outcome == "refused":
            self._refused(proposal, text)

    def _merged(self, record: PlanRecord) -> None:
        record.times.setdefault("merged", self._now_ns())
        record.error, record.on_main = None, True
        if not record.url:
            self._decisions.pull_request(record)
        self.statistics.plans["merged"] += 1
        self._observer.watch(record)
        log.info("plan merged plan=%s commit=%s pull_request=%s", record.id, record.commit[:12], record.pull_request)

    def _settle_undecided(self) -> None:
        """A proposal that was put aside may have been merged after all."""
        for record in [r for r in self._undecided if self._world.deployment.contains(r.commit)]:
            self._undecided.remove(record)
            self._merged(record)

    def _outdated(self, proposal: Proposal) -> None:
        self.statistics.plans["outdated"] += 1
        self._attempts += 1
        proposal.record.error = "main moved before the gate decided; built again"
        log.info("plan outdated plan=%s attempts=%d", proposal.plan.id, self._attempts)
        exhausted = self._attempts >= ATTEMPTS_MAX
        self._put_aside(proposal, PAUSE_SECONDS if exhausted else 0.0)
        self._attempts = 0 if exhausted else self._attempts

    def _put_aside(self, proposal: Proposal, pause: float) -> None:
        self._proposal = None
        self._undecided = [*self._undecided[1 - ATTEMPTS_MAX :], proposal.record]
        self._not_before = self._monotonic() + pause
        self._again(DEPLOYMENT)

    def _refused(self, proposal: Proposal, text: str) -> None:
        self.statistics.plans["refused"] += 1
        proposal.record.error = text
        number = proposal.record.pull_request
        log.error("plan refused plan=%s pull_request=%s reason=%r", proposal.plan.id, number, text)
        self._planner.refused(proposal.plan, proposal.record)
        self._proposal = None
        self._again()

    # -- planning -------------------------------------------------------------------------------------------------

    def _plan_if_free(self) -> None:
        """One proposal at a time; what comes meanwhile is answered by the next."""
        if self._proposal is not None or self._monotonic() < self._not_before:
            self._again()
            return
        with self._lock:
            self._flags -= PLANNED_FOR
            seen, self._demand_seen = self._demand_seen, None
        started = self._now_ns()
        plan = self._planner.plan(started)
        self._problem = ""
        if plan is not None:
            self._propose(plan, record_of(plan, seen or started, started))

    def _propose(self, plan: Plan, record: PlanRecord) -> None:
        record.commit = self._world.proposals.commit(plan.base, plan.files, plan.text)
        policy, _ = read_policy(self._catalogue.files)
        suites = [rule.name for rule in policy.suites] if policy else []
        body = describe(plan, self._planner.desired, self._planner.tasks, self._catalogue.catalogue, suites)
        proposal = Proposal(plan, record, self._monotonic())
        self.records.add(record)
        try:
            record.pull_request = self._world.proposals.propose(record.commit, plan.id, plan.title, body)
        except RefusalError as error:
            self._refused(proposal, error.message)
            return
        record.times["proposed"] = self._now_ns()
        self.statistics.plans["proposed"] += 1
        self._proposal = proposal
        log.info(
            "plan proposed plan=%s pull_request=%s created=%d changed=%d removed=%d milliseconds=%.0f subject=%r",
            *(plan.id, record.pull_request, len(record.created), len(record.changed), len(record.removed)),
            *((record.times["proposed"] - record.times["started"]) / 1e6, plan.title),
        )

    # -- reporting ------------------------------------------------------------------------------------------------

    def _situation(self) -> Situation:
        return Situation(
            outcomes=self._planner.desired.outcomes,
            held=self._planner.held,
            present=self._main.tree.releases,
            applications=self._world.cluster.applications(),
            proposed=self._proposal.record if self._proposal else None,
            committed=self.records.committed,
        )

    def _observed(self, record: PlanRecord) -> None:
        """The one line per plan."""
        self.statistics.plans["observed"] += 1
        begin = record.times.get("demand_seen", 0)
        steps = " ".join(f"{name}_ms={(at - begin) / 1e6:.0f}" for name, at in record.times.items() if begin)
        log.info(
            "plan observed plan=%s commit=%s pull_request=%s %s tasks=%s subject=%r note=%r",
            *(record.id, record.commit[:12], record.pull_request, steps, ",".join(record.tasks)),
            *(record.subject, record.error or ""),
        )


def metrics_text(statistics: ManagerStatistics) -> str:
    """The statistics as Prometheus text."""
    lines = [
        "# TYPE robotkube_manager_plans_total counter",
        *(f'robotkube_manager_plans_total{{step="{k}"}} {v}' for k, v in statistics.plans.items()),
        "# TYPE robotkube_manager_steps_total counter",
        f"robotkube_manager_steps_total {statistics.steps}",
        "# TYPE robotkube_manager_failures_total counter",
        f"robotkube_manager_failures_total {statistics.failures}",
    ]
    return "\n".join(lines) + "\n"
