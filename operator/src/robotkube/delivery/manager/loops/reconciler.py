"""The application manager: from tasks, nodes and catalogue to proposals, and from merged plans to the tasks' statuses.

Level-triggered and single-threaded: a step reads everything again, computes what should be on main, proposes the
difference, looks at the decision about an earlier proposal and at the cluster. Webhooks and watches only bring the next
step forward; after a restart the next step finds everything in Git, in the tasks and in the cluster. Tasks that arrive
while a proposal waits for its decision are answered together by the next plan. Only the process that leads writes; the
others fetch main from time to time, so that they know that they could take over.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.delivery.deployment.core.commit_messages import REPAIR, write_message
from robotkube.delivery.deployment.loops.main_history import Terms
from robotkube.delivery.manager.core.explanations import Explanation
from robotkube.delivery.manager.core.plans import Plan, describe
from robotkube.delivery.manager.loops.counters import ManagerStatistics
from robotkube.delivery.manager.loops.main_reader import MainReader, catalogue_page
from robotkube.delivery.manager.loops.planner import Planner
from robotkube.delivery.manager.loops.proposals.gate_decisions import GateDecisions, PendingProposal
from robotkube.delivery.manager.loops.proposals.open_proposals import OpenProposals, asked_for, superseded
from robotkube.delivery.manager.loops.proposals.plan_comments import PlanOutcomeComments
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord, PlanRecords, record_of, records_of
from robotkube.delivery.manager.loops.proposals.repairs import MainRepair
from robotkube.delivery.manager.loops.task_status import Situation, StatusWriter
from robotkube.delivery.manager.loops.upkeep import Upkeep
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.core.task_description import FORGE_BUSY, FORGE_UNAVAILABLE, MAIN_BROKEN
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.errors import RefusalError, RobotKubeError, UnavailableError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS, is_quiet, resync_is_due
from robotkube.foundation.forge.ports.pull_requests import Forge
from robotkube.foundation.forge.ports.repositories import DeploymentRepository, Proposals
from robotkube.foundation.kubernetes.ports import Leadership
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue, read_policy

DECISION_POLL_SECONDS = 1.0  # the forge's webhook is the normal way; asking costs the forge what the gate needs
DECISION_EAGER_SECONDS = 5.0
DECISION_POLL_SECONDS_LATER = 2.0
ATTEMPTS_MAX = 10  # how often a plan is built again at once; then its tasks are told, and it is tried again later
PAUSE_SECONDS = 5.0
MAIN_SECONDS = 5.0  # a file broken by hand is named within 10 s, also when the forge's delivery is lost
STANDBY_SECONDS = 0.5
OBSERVE_POLL_SECONDS = 1.0
FAILURE_SECONDS_FIRST, FAILURE_SECONDS_MAX = 1.0, 2.0
SILENT_SECONDS_MAX = 30.0
SAID_SECONDS = 3.0  # after so long without the forge the tasks are told
TASKS, NODES, APPLICATIONS, DEPLOYMENT, CATALOGUE = "tasks", "nodes", "applications", "deployment", "catalogue"
PLANNED_FOR = frozenset({TASKS, NODES, DEPLOYMENT, CATALOGUE})

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ManagerPorts:
    """The ports that the manager works with; `name` is its own, which is its account at the forge."""

    tasks: TaskStore
    cluster: Cluster
    deployment: DeploymentRepository
    proposals: Proposals
    forge: Forge
    leadership: Leadership
    name: str = "manager"


class ApplicationManager:
    """One manager for one deployment repository; `run` on one thread, `wake` from any.

    `now_ns` is the wall clock in ns since 1970, `monotonic` a clock in seconds that never goes back; `rest` is called
    after each step: what has to be done now and then, and must not be done within one.
    """

    def __init__(
        self,
        world: ManagerPorts,
        catalogue: AssuredCatalogue,
        main: MainReader,
        planner: Planner,
        observer: PlanObserver,
        now_ns: Callable[[], int],
        monotonic: Callable[[], float],
        rest: Callable[[], None] = lambda: None,
        jitter: Random = random.random,
    ) -> None:
        self._jitter = jitter
        self._world, self._catalogue, self._main, self._planner = world, catalogue, main, planner
        self._observer, self._now_ns, self._monotonic, self._rest = observer, now_ns, monotonic, rest
        self._statuses = StatusWriter(world.tasks, now_ns)
        self.statistics = ManagerStatistics()
        self.records = PlanRecords(now_ns())
        self._flags = {TASKS, DEPLOYMENT, CATALOGUE}
        self._lock, self._woken = threading.Lock(), threading.Event()
        self._told_tip = ""
        self._demand_seen: int | None = None
        self._decisions = GateDecisions(world.deployment, world.forge, monotonic)
        self._open = OpenProposals(world.deployment, world.forge, world.name)
        self._repairing = MainRepair(main, planner.foreign)
        self._telling = PlanOutcomeComments(world.cluster, world.forge)
        self._upkeep = Upkeep(world.cluster, world.tasks, planner.agents, monotonic)
        self._terms = Terms(world.deployment, [world.name])
        self._term: int | None = None
        self._proposal: PendingProposal | None = None
        self._undecided: list[PlanRecord] = []
        self._attempts, self._exhausted = 0, False
        self._begun = False
        self._not_before = self._looked_at = self._main_looked_at = self._seen_at = float("-inf")
        self._planned_at = float("-inf")
        self._problem = "has not looked at the world yet"

    def catalogue_page(self) -> dict[str, Any]:
        """The document of GET /catalogue."""
        return catalogue_page(self._catalogue.catalogue, self._catalogue.tip)

    def what_if(self, document: Mapping[str, Any]) -> Explanation:
        """What would become of a TaskDescription, without any effect; from any thread."""
        return self._planner.what_if(document)

    # -- waking ---------------------------------------------------------------------------------------------------

    def wake(self, what: str, tip: str = "") -> None:
        """Something may have changed: TASKS, NODES, APPLICATIONS, DEPLOYMENT or CATALOGUE. `tip`: main's new tip when
        the forge said it under its signature, which saves fetching what was proposed from here; it is no news when it
        was read already, as when the forge tells later what the gate had told."""
        if what == DEPLOYMENT and tip and tip == self._main.tip:
            return
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
        """Empty when the forge was seen lately, and nothing stops planning: here when this process leads, else it could
        take over from the one that does."""
        leadership = self._world.leadership
        if leadership.term() is None and leadership.leader() is None:
            return ["no process of this manager is known to lead"]
        silent = self._monotonic() - self._seen_at
        late = [f"the forge was not seen for {silent:.0f} s"] if SILENT_SECONDS_MAX < silent < float("inf") else []
        return late + ([self._problem] if self._problem else [])

    def run(self, stopping: threading.Event) -> None:
        """Steps until `stopping` is set; errors of the world are logged and met again after a pause."""
        pause, failures = 0.0, 0
        while not stopping.is_set():
            self._woken.wait(pause)
            self._woken.clear()
            try:
                pause, failures = self.step(), 0
                self._rest()
            except RobotKubeError as error:
                self._failed(error)
                stopping.wait(backoff(failures, FAILURE_SECONDS_FIRST, FAILURE_SECONDS_MAX, self._jitter))
                pause, failures = 0.0, failures + 1

    def _leads(self) -> bool:
        """Whether this process may write now. One that is newly elected begins like one that was started."""
        term = self._world.leadership.term()
        if term is not None and term != self._term:
            log.info("leading manager=%s term=%d", self._world.name, term)
            self._proposal, self._begun = None, False
            self._term = term
            self._again(DEPLOYMENT, CATALOGUE)
        self.statistics.term = term or 0
        return term is not None

    def _failed(self, error: RobotKubeError) -> None:
        self.statistics.step(failed=True)
        if self._problem != str(error):
            log.error("step failed reason=%r", str(error))
        self._problem = str(error)
        self._again(DEPLOYMENT, CATALOGUE)
        late = self._monotonic() - self._seen_at > SAID_SECONDS
        if late and isinstance(error, UnavailableError) and self._world.leadership.term() is not None:
            self._say_forge_unavailable()

    def _say_forge_unavailable(self) -> None:
        """The statuses are in the cluster, which may well answer while the forge does not."""
        text = "the forge does not answer; the task waits, and goes on when the forge is back"
        try:
            self._statuses.write(replace(self._situation(), obstacle=(FORGE_UNAVAILABLE, text)))
        except RobotKubeError as error:
            log.error("statuses not written reason=%r", str(error))

    def _again(self, *what: str) -> None:
        """The next step plans again, whatever was seen before."""
        with self._lock:
            self._flags |= {TASKS, *what}

    # -- one step -------------------------------------------------------------------------------------------------

    def step(self) -> float:
        """Look, decide, plan, observe, report; the seconds until the next step is due without being woken.
        Nothing of that while another process leads."""
        if not self._leads():
            return self._stand_by()
        with self._lock:
            flags, self._flags = self._flags, set()
            told, self._told_tip = self._told_tip, ""
        if resync_is_due(self._monotonic() - self._looked_at, self._idle_seconds()):
            flags |= {TASKS, DEPLOYMENT, CATALOGUE}
            self._looked_at = self._monotonic()
        if self._seconds_until_due() <= 0:
            flags |= {TASKS}
        if self._monotonic() - self._main_looked_at >= MAIN_SECONDS:
            flags |= {DEPLOYMENT}
        reads = DEPLOYMENT in flags or self._decision_is_due(flags)
        self._look(flags, reads, told)
        if self._proposal is not None and reads:
            self._follow(self._proposal)
        closed = self._proposal is not None and TASKS in flags and self._supersede(self._proposal)
        if closed:
            pass  # main is read first: the gate may have been faster
        elif flags & PLANNED_FOR or self._flags & PLANNED_FOR:
            self._plan_if_free()
        if flags & PLANNED_FOR:
            self._upkeep.look()
        for record in self._observer.look(self._main.tree.releases, self._main.tip):
            self._observed(record)
        for record in self._observer.given_up():
            self.statistics.plan(record, "unobserved")
        self._statuses.write(self._situation())
        if is_quiet(self._idle_seconds()):
            self._telling.tell_one()
        self.statistics.step()
        self._problem = ""
        return self._pause()

    def _idle_seconds(self) -> float:
        """Since the forge had work with a plan of this manager."""
        return 0.0 if self._proposal is not None else self._monotonic() - self._planned_at

    def _decision_is_due(self, flags: set[str]) -> bool:
        """Whether it is looked for although nobody has told of one. Not for every task or node that changes meanwhile:
        the forge has enough to do for the gate. Before a proposal is closed it is."""
        if self._proposal is None:
            return False
        late = self._monotonic() - max(self._main_looked_at, self._proposal.since) >= DECISION_POLL_SECONDS
        return late or (TASKS in flags and superseded(self._proposal.asked, self._world.tasks.tasks()))

    def _stand_by(self) -> float:
        """Fetch main now and then: whoever leads next can, and need not fetch much."""
        if self._monotonic() - self._looked_at >= RESYNC_SECONDS:
            self._world.deployment.fetch()
            self._looked_at = self._seen_at = self._monotonic()
            self._problem = ""
        return STANDBY_SECONDS

    def _pause(self) -> float:
        if self._proposal is not None:
            eager = self._monotonic() - self._proposal.since < DECISION_EAGER_SECONDS
            return DECISION_POLL_SECONDS if eager else DECISION_POLL_SECONDS_LATER
        if self._flags & PLANNED_FOR:
            return min(max(self._not_before - self._monotonic(), 0.0), RESYNC_SECONDS)
        pause = OBSERVE_POLL_SECONDS if self._observer.waiting or self._telling.waiting else MAIN_SECONDS
        held = self._statuses.seconds_until_due()
        return min(pause, max(self._seconds_until_due(), 0.0), pause if held is None else held)

    def _seconds_until_due(self) -> float:
        """Until time alone changes what is wanted: a lease or a place in the queue ends."""
        due = self._planner.next_due_ns
        return RESYNC_SECONDS if due is None else (due - self._now_ns()) / 1e9

    def _look(self, flags: set[str], reads: bool, told: str) -> None:
        """Read the catalogue when it may have changed, and main when `reads`; `told` is main's tip as last told."""
        if CATALOGUE in flags:
            self._catalogue.read()
        if reads:
            self._main_looked_at = self._monotonic()
            own = self._proposal is not None and told == self._proposal.record.commit
            if self._main.read(told if own else ""):
                self._again()
                self._settle_undecided()
                self._remember()
            self.statistics.broken_files = len(self._main.tree.suspects)
        self._seen_at = self._monotonic()

    def _remember(self) -> None:
        """Plans on main that this process has no record of: after a start, or when an answer of the forge was lost."""
        mine = self._proposal.record.id if self._proposal else ""
        unknown = [
            r
            for r in records_of(self._main.news, self._world.name)
            if r.id != mine and not self.records.has_merged(r.id)
        ]
        pulls = {pull.head: pull for pull in self._world.forge.pull_requests("all")} if unknown else {}
        for record in unknown:
            self._decisions.name(record, pulls.get(record.commit))
            self.records.add(record)
            self._observer.watch(record)
        if unknown:
            self._observer.forget_observed(self._main.tree.releases)

    # -- following a proposal ---------------------------------------------------------------------------------------

    def _follow(self, proposal: PendingProposal) -> None:
        """Merged, outdated, refused, or no decision yet: then it waits as long as it takes, since the gate decides what
        it finds open whenever it comes back."""
        outcome, text = self._decisions.look(proposal, self._main.tip)
        if outcome == "merged":
            self._merged(proposal.record)
            self._proposal, self._attempts, self._exhausted = None, 0, False
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
        self.statistics.plan(record, "merged")
        self._observer.watch(record)
        log.info("plan merged plan=%s commit=%s pull_request=%s", record.id, record.commit[:12], record.pull_request)

    def _settle_undecided(self) -> None:
        """A proposal that was put aside may have been merged after all."""
        for record in [r for r in self._undecided if self._world.deployment.contains(r.commit)]:
            self._undecided.remove(record)
            self._merged(record)

    def _supersede(self, proposal: PendingProposal) -> bool:
        """Close a proposal when none of its tasks is wanted as it was; should the gate have been faster, it is on main,
        and the next plan takes it away again."""
        if not superseded(proposal.asked, self._world.tasks.tasks()):
            return False
        pull = self._decisions.pull_request(proposal.record)
        if pull is not None and not pull.merged:
            self._open.close(pull.number, "every task of this plan was withdrawn or changed")
        proposal.record.error = "every task of this plan was withdrawn or changed"
        self.statistics.plan(proposal.record, "superseded")
        log.info("plan superseded plan=%s pull_request=%s", proposal.plan.id, proposal.record.pull_request)
        self._put_aside(proposal, 0.0)
        return True

    def _outdated(self, proposal: PendingProposal) -> None:
        self._attempts += 1
        proposal.record.error = "main moved before the gate decided; built again"
        self.statistics.plan(proposal.record, "outdated")
        log.info("plan outdated plan=%s attempts=%d", proposal.plan.id, self._attempts)
        if exhausted := self._attempts >= ATTEMPTS_MAX:
            self._attempts, self._exhausted = 0, True
        self._put_aside(proposal, PAUSE_SECONDS if exhausted else 0.0)

    def _put_aside(self, proposal: PendingProposal, pause: float) -> None:
        self._proposal = None
        self._undecided = [*self._undecided[1 - ATTEMPTS_MAX :], proposal.record]
        self._not_before = self._monotonic() + pause
        self._again(DEPLOYMENT)

    def _refused(self, proposal: PendingProposal, text: str) -> None:
        proposal.record.error = text
        self.statistics.plan(proposal.record, "refused")
        number = proposal.record.pull_request
        log.error("plan refused plan=%s pull_request=%s reason=%r", proposal.plan.id, number, text)
        if self._is_behind():
            pass  # it was refused for its term, not for what it does
        elif REPAIR in proposal.plan.message.kinds:
            self._repairing.refused(proposal.plan)
        elif not self._main.tree.problems:
            self._planner.refused(proposal.plan, proposal.record)
        self._proposal = None
        self._again(DEPLOYMENT)

    def _is_behind(self) -> bool:
        """Whether main has a higher term of this manager than this process: another one leads, and the election will
        say so; or the Lease was lost with its cluster, and this one has to be elected with a higher one."""
        last = self._terms.last(self._world.name, self._main.tip)
        if self._term is None or last <= self._term:
            return False
        self._world.leadership.overtake(last)
        return True

    # -- planning -------------------------------------------------------------------------------------------------

    def _plan_if_free(self) -> None:
        """One proposal at a time; what comes meanwhile is answered by the next."""
        if self._proposal is not None or self._monotonic() < self._not_before:
            self._again()
            return
        with self._lock:
            self._flags -= PLANNED_FOR
            seen, self._demand_seen = self._demand_seen, None
        started, begun = self._now_ns(), self._monotonic()
        plan = self._planner.plan(started) if not self._main.tree.problems else self._repairing.plan(started)
        self.statistics.decided(self._monotonic() - begun)
        if self._took_over(plan, seen or started, started) or plan is None:
            return
        named = self._repairing.named(plan)
        self._propose(named, record_of(named, seen or started, started))

    def _took_over(self, plan: Plan | None, seen: int, started: int) -> bool:
        """Once per term: whether a proposal that is open already does what `plan` does; it is followed as if it had
        been made here. A process that is behind main proposes nothing either."""
        if self._begun:
            return False
        if self._is_behind():
            return True
        found = self._open.find(plan)
        self._begun = True
        if plan is None or found is None:
            return False
        pull, identifier = found
        record = record_of(plan, seen, started)
        record.id, record.commit = identifier, pull.head
        record.pull_request, record.url = pull.number, pull.url
        record.times["proposed"] = started
        self.records.add(record)
        self.statistics.plan(record, "taken_over")
        self._proposal = PendingProposal(plan, record, self._monotonic(), asked=asked_for(plan, self._planner.tasks))
        log.info("plan taken over plan=%s pull_request=%d", record.id, pull.number)
        return True

    def _propose(self, plan: Plan, record: PlanRecord) -> None:
        if self._term is None or self._world.leadership.term() != self._term:
            self._again()
            return
        message = write_message(plan.message.signed(self._world.name, self._term))
        record.commit = self._world.proposals.commit(plan.base, plan.files, message)
        proposal = PendingProposal(plan, record, self._monotonic(), asked=asked_for(plan, self._planner.tasks))
        self.records.add(record)
        try:
            number = self._world.proposals.propose(record.commit, plan.id, plan.title, self._body(plan))
            record.pull_request = number
        except RefusalError as error:
            self._refused(proposal, error.message)
            return
        record.times["proposed"] = self._now_ns()
        self.statistics.plan(record, "proposed")
        self._proposal, self._planned_at = proposal, self._monotonic()
        log.info(
            "plan proposed plan=%s pull_request=%s created=%d changed=%d removed=%d milliseconds=%.0f subject=%r",
            *(plan.id, record.pull_request, len(record.created), len(record.changed), len(record.removed)),
            *((record.times["proposed"] - record.times["started"]) / 1e6, plan.title),
        )

    def _body(self, plan: Plan) -> str:
        if REPAIR in plan.message.kinds:
            return self._repairing.describe(plan)
        policy, _ = read_policy(self._catalogue.files)
        suites = [rule.name for rule in policy.suites] if policy else []
        return describe(plan, self._planner.desired, self._planner.tasks, self._catalogue.catalogue, suites)

    # -- reporting ------------------------------------------------------------------------------------------------

    def _situation(self) -> Situation:
        return Situation(
            outcomes=self._planner.outcomes,
            offloaded=self._planner.offloaded,
            held=self._planner.held,
            waiting=self._planner.waiting,
            present=self._main.tree.releases,
            applications=self._world.cluster.applications(),
            proposed=self._proposal.record if self._proposal else None,
            committed=self.records.committed,
            edited=self._main.standing_edits(),
            obstacle=self._obstacle(),
        )

    def _obstacle(self) -> tuple[str, str] | None:
        """Reason and words of what holds every plan of this manager."""
        if broken := self._repairing.broken:
            return MAIN_BROKEN, broken
        if self._exhausted:
            text = f"main moved {ATTEMPTS_MAX} times before the gate decided; tried again every {PAUSE_SECONDS:.0f} s"
            return FORGE_BUSY, text
        return None

    def _observed(self, record: PlanRecord) -> None:
        """The one line per plan."""
        self.statistics.plan(record, "observed")
        self._telling.observed(record)
        begin = record.times.get("demand_seen", 0)
        steps = " ".join(f"{name}_ms={(at - begin) / 1e6:.0f}" for name, at in record.times.items() if begin)
        log.info(
            "plan observed plan=%s commit=%s pull_request=%s %s tasks=%s subject=%r note=%r",
            *(record.id, record.commit[:12], record.pull_request, steps, ",".join(record.tasks)),
            *(record.subject, record.error or ""),
        )
