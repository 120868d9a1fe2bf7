"""The application manager: from tasks, nodes and catalogue to proposals, and from merged plans to the tasks' statuses.

Level-triggered and single-threaded: a step reads everything again, computes what should be on main, proposes the
difference, polls the decision about an earlier proposal and observes the cluster. Webhooks and watches only bring the
next step forward; after a restart the next step reads everything in Git, in the tasks and in the cluster. Tasks that
arrive while a proposal waits for its decision are answered together by the next plan. Only the process that leads
writes; the others fetch main from time to time, so that they know that they could take over.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.delivery.deployment.core.commit_messages import REPAIR, write_message
from robotkube.delivery.deployment.loops.main_history import Terms
from robotkube.delivery.manager.core.explanations import Explanation
from robotkube.delivery.manager.core.plans import Plan
from robotkube.delivery.manager.loops.counters import ManagerStatistics
from robotkube.delivery.manager.loops.main_reader import MainReader, catalogue_page
from robotkube.delivery.manager.loops.planner import Planner
from robotkube.delivery.manager.loops.proposals.gate_decisions import GateDecisions, PendingProposal
from robotkube.delivery.manager.loops.proposals.open_proposals import OpenProposals, asked_for, superseded
from robotkube.delivery.manager.loops.proposals.plan_comments import PlanOutcomeComments
from robotkube.delivery.manager.loops.proposals.plan_observer import PlanObserver
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord, PlanRecords, record_of, records_of
from robotkube.delivery.manager.loops.proposals.refused_plans import ForgeRefusals
from robotkube.delivery.manager.loops.proposals.repairs import MainRepair
from robotkube.delivery.manager.loops.task_status import Situation, StatusWriter
from robotkube.delivery.manager.loops.upkeep import Upkeep
from robotkube.delivery.manager.ports.manager_ports import ManagerPorts
from robotkube.delivery.tasks.core.task_description import FORGE_BUSY, FORGE_UNAVAILABLE, MAIN_BROKEN
from robotkube.errors import RefusalError, RobotKubeError, UnavailableError
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS, is_quiet, resync_is_due
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue

DECISION_POLL_SECONDS = 1.0  # the forge's webhook is the normal way; asking costs the forge what the gate needs
DECISION_EAGER_SECONDS = 5.0
DECISION_POLL_SECONDS_LATER = 2.0
ATTEMPTS_MAX = 10  # how often a plan is built again at once; then its tasks say so, and it is tried again later
PAUSE_SECONDS = 5.0
MAIN_SECONDS = 5.0  # a file broken by hand is named within 10 s, also when the forge's delivery is lost
STANDBY_SECONDS = 0.5
OBSERVE_POLL_SECONDS = 1.0
FAILURE_SECONDS_FIRST, FAILURE_SECONDS_MAX = 1.0, 2.0
SILENT_SECONDS_MAX = 30.0
REPORT_AFTER_SECONDS = 3.0  # after so long without the forge the tasks' statuses say so
TASKS, NODES, APPLICATIONS, DEPLOYMENT, CATALOGUE = "tasks", "nodes", "applications", "deployment", "catalogue"
PLANNED_FOR = frozenset({TASKS, NODES, DEPLOYMENT, CATALOGUE})

log = logging.getLogger(__name__)


class ApplicationManager:
    """One manager for one deployment repository; `run` on one thread, `wake` from any.

    `now_ns` is the wall clock in ns since 1970, `monotonic` a clock in seconds that never goes back; `after_step` is
    called after each step: what has to be done now and then, and must not be done within one.
    """

    def __init__(
        self,
        ports: ManagerPorts,
        catalogue: AssuredCatalogue,
        main: MainReader,
        planner: Planner,
        observer: PlanObserver,
        now_ns: Callable[[], int],
        monotonic: Callable[[], float],
        after_step: Callable[[], None] = lambda: None,
        jitter: Random = random.random,
    ) -> None:
        self._jitter = jitter
        self._ports = ports
        self._catalogue = catalogue
        self._main = main
        self.planner = planner
        self._observer = observer
        self._now_ns = now_ns
        self._monotonic = monotonic
        self._after_step = after_step
        self._statuses = StatusWriter(ports.tasks, now_ns, ports.broken_links, ports.cluster.pods)
        self.statistics = ManagerStatistics()
        self.records = PlanRecords(now_ns())
        self._flags = {TASKS, DEPLOYMENT, CATALOGUE}
        self._lock = threading.Lock()
        self._woken = threading.Event()
        self._webhook_tip = ""
        self._demand_seen: int | None = None
        self._decisions = GateDecisions(ports.deployment, ports.forge, monotonic)
        self._open = OpenProposals(ports.deployment, ports.forge, ports.name)
        self._repairing = MainRepair(main, planner.foreign)
        self._refused_by_forge = ForgeRefusals(monotonic, planner.refused_plans, self._repairing)
        self._outcome_comments = PlanOutcomeComments(ports.cluster, ports.forge)
        self._upkeep = Upkeep(ports.cluster, ports.tasks, lambda: planner.agents, monotonic)
        self._terms = Terms(ports.deployment, [ports.name])
        self._term: int | None = None
        self._proposal: PendingProposal | None = None
        self._undecided: list[PlanRecord] = []
        self._attempts = 0
        self._exhausted = False
        self._begun = False
        self._not_before = self._resynced_at = self._main_read_at = self._forge_seen_at = float("-inf")
        self._planned_at = float("-inf")
        self._problem = "has not read main and the cluster yet"

    def catalogue_page(self) -> dict[str, Any]:
        """The document of GET /catalogue."""
        return catalogue_page(self._catalogue.catalogue, self._catalogue.tip)

    def what_if(self, question: Mapping[str, Any] | str) -> Explanation:
        """What would become of a TaskDescription, or without the task of a key; no effect; from any thread."""
        return self.planner.what_if(question)

    # -- waking ---------------------------------------------------------------------------------------------------

    def wake(self, what: str, tip: str = "") -> None:
        """Bring the next step forward: TASKS, NODES, APPLICATIONS, DEPLOYMENT or CATALOGUE may have changed. `tip` is
        main's new tip when a signed webhook names it, which saves fetching what was proposed from here; one that was
        read already changes nothing, as when the forge's webhook comes after the gate's."""
        if what == DEPLOYMENT and tip and tip == self._main.tip:
            return
        with self._lock:
            self._flags.add(what)
            self._webhook_tip = tip or self._webhook_tip
            if what in PLANNED_FOR and self._demand_seen is None:
                self._demand_seen = self._now_ns()
        self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the step that is under way."""
        stopping.set()
        self._woken.set()

    def reasons_not_ready(self) -> list[str]:
        """The reasons why the process is not ready: the forge did not answer lately, or something stops planning. None
        of them means that this process leads, or could take over from the one that does."""
        leadership = self._ports.leadership
        if leadership.term() is None and leadership.leader() is None:
            return ["no process of this manager is known to lead"]
        silent = self._monotonic() - self._forge_seen_at
        late = [f"the forge was not seen for {silent:.0f} s"] if SILENT_SECONDS_MAX < silent < float("inf") else []
        return late + ([self._problem] if self._problem else [])

    def run(self, stopping: threading.Event) -> None:
        """Run steps until `stopping` is set; a step that failed is logged, and the next one follows after a pause."""
        pause = 0.0
        failures = 0
        while not stopping.is_set():
            self._woken.wait(pause)
            self._woken.clear()
            try:
                pause = self.step()
                failures = 0
                self._after_step()
            except RobotKubeError as error:
                self._failed(error)
                stopping.wait(backoff(failures, FAILURE_SECONDS_FIRST, FAILURE_SECONDS_MAX, self._jitter))
                pause = 0.0
                failures += 1

    def _leads(self) -> bool:
        """Return whether this process may write now. One that is newly elected begins like one that was started."""
        term = self._ports.leadership.term()
        if term is not None and term != self._term:
            log.info("leading manager=%s term=%d", self._ports.name, term)
            self._proposal = None
            self._begun = False
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
        late = self._monotonic() - self._forge_seen_at > REPORT_AFTER_SECONDS
        if late and isinstance(error, UnavailableError) and self._ports.leadership.term() is not None:
            self._report_forge_unavailable()

    def _report_forge_unavailable(self) -> None:
        """Write into the tasks' statuses that the forge does not answer; the cluster may well answer meanwhile."""
        text = "the forge does not answer; the task waits, and goes on when the forge is back"
        try:
            self._statuses.write(replace(self._situation(), obstacle=(FORGE_UNAVAILABLE, text)))
        except RobotKubeError as error:
            log.error("statuses not written reason=%r", str(error))

    def _again(self, *what: str) -> None:
        """Make the next step plan again, whatever was read before."""
        with self._lock:
            self._flags |= {TASKS, *what}

    # -- one step -------------------------------------------------------------------------------------------------

    def step(self) -> float:
        """Do one step: read, plan, observe, report; return the seconds until the next one is due without being woken.
        While another process leads, only stand by."""
        if not self._leads():
            return self._stand_by()
        with self._lock:
            flags, self._flags = self._flags, set()
            webhook_tip, self._webhook_tip = self._webhook_tip, ""
        if resync_is_due(self._monotonic() - self._resynced_at, self._idle_seconds()):
            flags |= {TASKS, DEPLOYMENT, CATALOGUE}
            self._resynced_at = self._monotonic()
        if self._seconds_until_due() <= 0 or self._refused_by_forge.forget_when_due():
            flags |= {TASKS}
        if self._monotonic() - self._main_read_at >= MAIN_SECONDS:
            flags |= {DEPLOYMENT}
        reads = DEPLOYMENT in flags or self._decision_is_due(flags)
        self._read(flags, reads, webhook_tip)
        if self._proposal is not None and reads:
            self._poll_decision(self._proposal)
        closed = self._proposal is not None and TASKS in flags and self._supersede(self._proposal)
        # after a proposal was closed main is read first: the gate may have been faster
        if not closed and (flags & PLANNED_FOR or self._flags & PLANNED_FOR):
            self._plan_if_free()
        if flags & PLANNED_FOR:
            self._upkeep.resync()
        for record in self._observer.observe(self._main.tree.releases, self._main.tip):
            self._observed(record)
        for record in self._observer.given_up():
            self.statistics.plan(record, "unobserved")
        self._statuses.write(self._situation())
        if is_quiet(self._idle_seconds()):
            self._outcome_comments.send_oldest()
        self.statistics.step()
        self._problem = ""
        return self._pause()

    def _idle_seconds(self) -> float:
        """The seconds since the forge had work with a plan of this manager."""
        return 0.0 if self._proposal is not None else self._monotonic() - self._planned_at

    def _decision_is_due(self, flags: set[str]) -> bool:
        """Return whether the gate's decision is polled although no webhook reported one: when it is late, and before a
        proposal is closed. Not for every task or node that changes: the forge has enough to do for the gate."""
        if self._proposal is None:
            return False
        late = self._monotonic() - max(self._main_read_at, self._proposal.since) >= DECISION_POLL_SECONDS
        return late or (TASKS in flags and superseded(self._proposal.asked, self._ports.tasks.tasks()))

    def _stand_by(self) -> float:
        """Fetch main now and then: whoever leads next can, and need not fetch much."""
        if self._monotonic() - self._resynced_at >= RESYNC_SECONDS:
            self._ports.deployment.fetch()
            self._resynced_at = self._forge_seen_at = self._monotonic()
            self._problem = ""
        return STANDBY_SECONDS

    def _pause(self) -> float:
        if self._proposal is not None:
            eager = self._monotonic() - self._proposal.since < DECISION_EAGER_SECONDS
            return DECISION_POLL_SECONDS if eager else DECISION_POLL_SECONDS_LATER
        if self._flags & PLANNED_FOR:
            return min(max(self._not_before - self._monotonic(), 0.0), RESYNC_SECONDS)
        pause = OBSERVE_POLL_SECONDS if self._observer.waiting or self._outcome_comments.waiting else MAIN_SECONDS
        held = self._statuses.seconds_until_due()
        return min(pause, max(self._seconds_until_due(), 0.0), pause if held is None else held)

    def _seconds_until_due(self) -> float:
        """The seconds until time alone changes what is wanted: a lease or a place in the queue ends."""
        due = self.planner.next_due_ns
        return RESYNC_SECONDS if due is None else (due - self._now_ns()) / 1e9

    def _read(self, flags: set[str], reads: bool, webhook_tip: str) -> None:
        """Read the catalogue when it may have changed, and main when `reads`; `webhook_tip` is main's tip as the last
        webhook named it."""
        if CATALOGUE in flags:
            self._catalogue.read()
        if reads:
            self._main_read_at = self._monotonic()
            own = self._proposal is not None and webhook_tip == self._proposal.record.commit
            if self._main.read(webhook_tip if own else ""):
                self._again()
                self._settle_undecided()
                self._remember()
            self.statistics.broken_files = len(self._main.tree.suspects)
        self._forge_seen_at = self._monotonic()

    def _remember(self) -> None:
        """Make records of plans on main that have none: after a start, or when an answer of the forge was lost."""
        mine = self._proposal.record.id if self._proposal else ""
        planned = records_of(self._main.new_commits, self._ports.name)
        unknown = [r for r in planned if r.id != mine and not self.records.has_merged(r.id)]
        pulls = {pull.head: pull for pull in self._ports.forge.pull_requests("all")} if unknown else {}
        for record in unknown:
            self._decisions.name(record, pulls.get(record.commit))
            self.records.add(record)
            self._observer.watch(record)
        if unknown:
            self._observer.forget_observed(self._main.tree.releases)

    # -- the decision about a proposal ------------------------------------------------------------------------------

    def _poll_decision(self, proposal: PendingProposal) -> None:
        """Act on the gate's decision: merged, outdated or refused. Without one the proposal waits as long as it takes,
        since the gate decides what it finds open whenever it comes back."""
        outcome, text = self._decisions.poll(proposal, self._main.tip)
        if outcome == "merged":
            self._merged(proposal.record)
            self._proposal = None
            self._attempts = 0
            self._exhausted = False
            self.planner.accepted()
            self._again()
        elif outcome == "outdated":
            self._outdated(proposal)
        elif outcome == "refused":
            self._refused(proposal, text)

    def _merged(self, record: PlanRecord) -> None:
        record.times.setdefault("merged", self._now_ns())
        record.error = None
        record.on_main = True
        if not record.url:
            self._decisions.pull_request(record)
        self.statistics.plan(record, "merged")
        self._observer.watch(record)
        log.info("plan merged plan=%s commit=%s pull_request=%s", record.id, record.commit[:12], record.pull_request)

    def _settle_undecided(self) -> None:
        """Note the proposals that were put aside and merged after all."""
        for record in [r for r in self._undecided if self._ports.deployment.contains(r.commit)]:
            self._undecided.remove(record)
            self._merged(record)

    def _supersede(self, proposal: PendingProposal) -> bool:
        """Close a proposal when none of its tasks is wanted as it was; should the gate have been faster, it is on main,
        and the next plan takes it away again."""
        if not superseded(proposal.asked, self._ports.tasks.tasks()):
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
            self._attempts = 0
            self._exhausted = True
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
            self.planner.refused(proposal.plan, proposal.record)
        self._proposal = None
        self._again(DEPLOYMENT)

    def _is_behind(self) -> bool:
        """Return whether main has a higher term of this manager than this process: another one leads, as the election
        will show; or the Lease was lost with its cluster, and this one has to be elected with a higher one."""
        last = self._terms.last(self._ports.name, self._main.tip)
        if self._term is None or last <= self._term:
            return False
        self._ports.leadership.overtake(last)
        return True

    # -- planning -------------------------------------------------------------------------------------------------

    def _plan_if_free(self) -> None:
        """Plan and propose unless a proposal is open; what comes meanwhile is answered by the next."""
        if self._proposal is not None or self._monotonic() < self._not_before:
            self._again()
            return
        with self._lock:
            self._flags -= PLANNED_FOR
            seen, self._demand_seen = self._demand_seen, None
        started = self._now_ns()
        plan = self.planner.verified(lambda: self._decide(started))
        if self._took_over(plan, seen or started, started) or plan is None:
            return
        named = self._repairing.named(plan)
        self._propose(named, record_of(named, self.planner.desired, seen or started, started))

    def _decide(self, started: int) -> Plan | None:
        begun = self._monotonic()
        plan = self.planner.plan(started) if not self._main.tree.problems else self._repairing.plan(started)
        self.statistics.decided(self._monotonic() - begun, self.planner.updating.updates)
        return plan

    def _took_over(self, plan: Plan | None, seen: int, started: int) -> bool:
        """Return whether a proposal that is open already does what `plan` does, asked once per term; its decision is
        polled as if it had been made here. A process that is behind main proposes nothing either."""
        if self._begun:
            return False
        if self._is_behind():
            return True
        same_proposal = self._open.find(plan)
        self._begun = True
        if plan is None or same_proposal is None:
            return False
        pull, identifier = same_proposal
        record = record_of(plan, self.planner.desired, seen, started)
        record.id = identifier
        record.commit = pull.head
        self._decisions.name(record, pull)
        record.times["proposed"] = started
        self.records.add(record)
        self.statistics.plan(record, "taken_over")
        self._proposal = PendingProposal(plan, record, self._monotonic(), asked=asked_for(plan, self.planner.tasks))
        log.info("plan taken over plan=%s pull_request=%d", record.id, pull.number)
        return True

    def _propose(self, plan: Plan, record: PlanRecord) -> None:
        if self._term is None or self._ports.leadership.term() != self._term:
            self._again()
            return
        message = write_message(plan.message.signed(self._ports.name, self._term))
        record.commit = self._ports.proposals.commit(plan.base, plan.files, message)
        proposal = PendingProposal(plan, record, self._monotonic(), asked=asked_for(plan, self.planner.tasks))
        self.records.add(record)
        try:
            record.pull_request = self._ports.proposals.propose(record.commit, plan.id, plan.title, self._body(plan))
        except RefusalError as error:
            self._refused_by_forge.add(record.id)
            self._refused(proposal, error.message)
            return
        record.times["proposed"] = self._now_ns()
        self.statistics.plan(record, "proposed")
        self._proposal = proposal
        self._planned_at = self._monotonic()
        log.info(
            "plan proposed plan=%s pull_request=%s created=%d changed=%d removed=%d milliseconds=%.0f subject=%r",
            *(plan.id, record.pull_request, len(record.created), len(record.changed), len(record.removed)),
            *((record.times["proposed"] - record.times["started"]) / 1e6, plan.title),
        )

    def _body(self, plan: Plan) -> str:
        return (self._repairing if REPAIR in plan.message.kinds else self.planner).describe(plan)

    # -- reporting ------------------------------------------------------------------------------------------------

    def _situation(self) -> Situation:
        return Situation(
            outcomes=self.planner.outcomes,
            decided=self.planner.decided,
            offloaded=self.planner.offloaded,
            held=self.planner.held,
            waiting=self.planner.waiting,
            present=self._main.tree.releases,
            applications=self._ports.cluster.applications(),
            proposed=self._proposal.record if self._proposal else None,
            committed=self.records.committed,
            edited=self._main.standing_edits(),
            obstacle=self._obstacle(),
        )

    def _obstacle(self) -> tuple[str, str] | None:
        """Reason and message of what holds every plan of this manager."""
        if broken := self._repairing.broken:
            return MAIN_BROKEN, broken
        if self._exhausted:
            text = f"main moved {ATTEMPTS_MAX} times before the gate decided; tried again every {PAUSE_SECONDS:.0f} s"
            return FORGE_BUSY, text
        return None

    def _observed(self, record: PlanRecord) -> None:
        """Count and log a plan that is observed, and note its outcome for its pull request."""
        self.statistics.plan(record, "observed")
        self._outcome_comments.observed(record)
        begin = record.times.get("demand_seen", 0)
        steps = " ".join(f"{name}_ms={(at - begin) / 1e6:.0f}" for name, at in record.times.items() if begin)
        log.info(
            "plan observed plan=%s commit=%s pull_request=%s %s tasks=%s subject=%r note=%r",
            *(record.id, record.commit[:12], record.pull_request, steps, ",".join(record.tasks)),
            *(record.subject, record.error or ""),
        )
