"""The gate of the deployment repository: it checks pull requests, alone moves main by what it checked, announces it.

Level-triggered: a round reads the open pull requests and main's tip, decides and acts; a webhook only brings the next
round forward, and names the pull request to decide first. So lost webhooks, restarts and half-finished rounds are
repaired by the next round. A pull request whose commit is in main already is left to the forge, which marks it merged
by itself. No statement about a commit counts (statuses, labels): what is judged is read from Git, by whom it was
proposed from the forge. A manager may send its commit's objects, which saves fetching them: only a merge is decided on
those, and only the forge makes it one, by accepting the push onto main's tip. A manager's commit becomes main's tip as
it is; what a person proposes is joined with main, and what is pushed is checked as it will stand there.
"""

from __future__ import annotations

import logging
import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.delivery.deployment.core.merge_records import MergeRecord
from robotkube.delivery.deployment.core.policies.merge import APPROVAL, AUTOMATIC, Way
from robotkube.delivery.deployment.loops.unchecked_commits import UncheckedWatch
from robotkube.delivery.gate.core import verdict_comments
from robotkube.delivery.gate.core.check_results import READABLE, CheckResult
from robotkube.delivery.gate.core.proposal_checks import ProposalVerdict, ProposedCommit
from robotkube.delivery.gate.loops.decisions import Decision, Decisions
from robotkube.delivery.gate.loops.gate_statistics import GateStatistics
from robotkube.delivery.gate.loops.merge_records import MergeRecorder
from robotkube.delivery.gate.loops.pending_objects import PendingObjects
from robotkube.delivery.gate.loops.rules import GateRules, GateSettings
from robotkube.delivery.gate.loops.unchecked_report import NOTHING_READ, UncheckedReport
from robotkube.errors import DocumentError, InputError, RobotKubeError
from robotkube.foundation.forge.core.commit_objects import CommitObjects
from robotkube.foundation.forge.core.resync import RESYNC_SECONDS, resync_is_due
from robotkube.foundation.forge.core.reviews import approvers
from robotkube.foundation.forge.loops.merging import merge_commit
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest, PushHook
from robotkube.foundation.forge.ports.repositories import Commit, Commits, MainBranch
from robotkube.registry.catalogue.loops.verified_catalogue import AssuredCatalogue
from robotkube.registry.charts.core.values_schemas import Validate
from robotkube.registry.charts.ports import RenderedImages

POLL_SECONDS = 2.0  # open pull requests, when no webhook came for so long
FAILURE_SECONDS_MAX = 4.0  # the longest pause after rounds that failed; the first one's bound is POLL_SECONDS
SILENT_SECONDS_MAX = 30.0  # not ready when the forge was not seen for longer
HINTS_MAX = 100
WAKING_ACTIONS = frozenset({"opened", "reopened", "synchronized", "synchronize"})  # the last is GitHub's
REVIEWED = "reviewed"
REPAIR = "repair"  # in records, the way of a plan that only brings a broken main back

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Case:
    """One pull request under decision, with everything that decides about it; `approvers` are those who approved it, if
    the merge policy asks for them."""

    pull: PullRequest
    commit: Commit
    proposal: ProposedCommit
    verdict: ProposalVerdict
    way: Way
    approvers: tuple[str, ...]
    source: str
    check_seconds: float

    @property
    def mergeable(self) -> bool:
        return self.verdict.accepted and (self.way == AUTOMATIC or bool(self.approvers))

    def record(self, commit: str, previous: str, catalogue: str) -> MergeRecord:
        """What is recorded when main moves from `previous` to `commit` for this pull request, decided by that commit of
        the catalogue."""
        number = str(self.pull.number)
        way = REPAIR if self.verdict.repair else self.way
        return MergeRecord(commit, previous, self.pull.author, way, number, self.approvers, "", catalogue)


class Gate:
    """The gate of one deployment repository; `run` on one thread, `wake` from any.

    `commits` makes commits in the clone of `main`; `images` renders releases; `monotonic` is a clock in seconds that
    never goes back, `wall` one in nanoseconds since 1970; `managers` are notified of every commit that was merged here,
    sooner than by the forge; `recorder` signs what was merged, and `unchecked` watches main for what was not.
    """

    def __init__(
        self,
        forge: Forge,
        main: MainBranch,
        commits: Commits,
        catalogue: AssuredCatalogue,
        push_hook: PushHook,
        settings: GateSettings,
        validate: Validate,
        images: RenderedImages,
        monotonic: Callable[[], float],
        managers: Sequence[PushHook] = (),
        recorder: MergeRecorder | None = None,
        unchecked: UncheckedWatch | None = None,
        jitter: Random = random.random,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        self._forge = forge
        self._jitter = jitter
        self._main = main
        self._commits = commits
        self._push_hook = push_hook
        self._managers = tuple(managers)
        self._recorder = recorder
        self._settings = settings
        self._monotonic = monotonic
        self._rules = GateRules(settings, main, catalogue, validate, images, monotonic)
        self._unchecked = UncheckedReport(unchecked) if unchecked else None
        self.statistics = GateStatistics()
        self.decisions = Decisions(wall)
        self._announced = ""
        self._pending_objects = PendingObjects()
        self._settled: dict[int, str] = {}
        self._waiting: set[int] = set()
        self._first_lines: dict[int, set[str]] = {}
        self._hints: dict[int, PullRequest] = {}
        self._lock = threading.Lock()
        self._woken = threading.Event()
        self._resync_due = True
        self._catalogue_moved = False
        self._seen_at = monotonic() - SILENT_SECONDS_MAX - 1

    # -- waking ---------------------------------------------------------------------------------------------------

    def wake(self, event: str, payload: Mapping[str, Any]) -> None:
        """Receive a signed delivery of the forge: it decides what the next round reads, and that it comes now."""
        repository = (payload.get("repository") or {}).get("full_name")
        action = payload.get("action") if event.startswith("pull_request") else ""
        moved_main = event == "push" and payload.get("after") not in (self._main.tip, self._announced)
        if repository == self._settings.catalogue:
            self._catalogue_moved = True
        if repository == self._settings.catalogue or moved_main or action == REVIEWED:
            self._resync_due = True
            self._woken.set()
        elif action in WAKING_ACTIONS and repository == self._settings.deployment:
            self._hint(payload.get("pull_request") or {})
            self._woken.set()

    def add_objects(self, account: str, objects: CommitObjects) -> None:
        """Keep the objects of a commit that `account` may propose, from that proposer; they decide nothing."""
        self._pending_objects.keep(account, objects)

    def _hint(self, pull_request: Mapping[str, Any]) -> None:
        """Remember what was proposed: the round need not ask the forge for all that is open first."""
        author = (pull_request.get("user") or {}).get("login")
        head = (pull_request.get("head") or {}).get("sha")
        if not (isinstance(pull_request.get("number"), int) and isinstance(author, str) and isinstance(head, str)):
            return
        with self._lock:
            if len(self._hints) < HINTS_MAX:
                self._hints[pull_request["number"]] = PullRequest(
                    pull_request["number"], "", "", author, "open", head, False
                )

    def _pop_hints(self) -> list[PullRequest]:
        with self._lock:
            hints = self._hints
            self._hints = {}
        return [pull for _, pull in sorted(hints.items())]

    def unchecked(self) -> Mapping[str, Any]:
        """What came to main without its check; nothing where nobody watches."""
        return self._unchecked.as_json() if self._unchecked is not None else NOTHING_READ

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the round that is under way."""
        stopping.set()
        self._woken.set()

    def reasons_not_ready(self) -> list[str]:
        """Reasons why the gate is not ready; none while the forge answers."""
        silent = self._monotonic() - self._seen_at
        return [f"the forge was not seen for {silent:.0f} s"] if silent > SILENT_SECONDS_MAX else []

    def run(self, stopping: threading.Event) -> None:
        """Run rounds until `stopping` is set; an error of forge or Git is logged, and the next round tries again."""
        resynced_at = self._monotonic() - RESYNC_SECONDS
        listed_at = resynced_at
        answered_at = resynced_at
        failures = 0
        while not stopping.is_set():
            self._woken.clear()
            try:
                if self.answer_hints():
                    # deliveries arrive; asking for a list would only delay the next one
                    listed_at = self._monotonic()
                    answered_at = listed_at
                now = self._monotonic()
                resync = self._resync_due or resync_is_due(now - resynced_at, now - answered_at)
                if resync or now - listed_at >= POLL_SECONDS:
                    listed_at = now
                    if resync:  # a push that is notified in this very moment is not for a round that only lists
                        self._resync_due = False
                        resynced_at = now
                    self.round(resync)
                failures = 0
            except RobotKubeError as error:
                failures += 1
                listed_at = self._monotonic() - POLL_SECONDS  # what failed is tried again after the pause
                log.error("round failed reason=%s", error)
            self._woken.wait(self._pause(failures))

    def _pause(self, failures: int) -> float:
        """Seconds until the next round, unless somebody wakes it: more, and not all the same, after failures."""
        return backoff(failures - 1, POLL_SECONDS, FAILURE_SECONDS_MAX, self._jitter) if failures else POLL_SECONDS

    # -- one round ------------------------------------------------------------------------------------------------

    def answer_hints(self) -> int:
        """Decide the pull requests that webhooks named, by the catalogue as it was then, and return their number; what
        fails is still open in the next round."""
        hints = self._pop_hints()
        if hints and self._catalogue_moved:
            self._refresh()
        for pull in hints:
            if self._settled.get(pull.number) != pull.head:
                self._try_to_decide(pull)
        return len(hints)

    def round(self, fetch_main: bool = True) -> None:
        """Decide all open pull requests, oldest first, and announce main when it moved; it is fetched before when
        `fetch_main`."""
        self.statistics.rounds += 1
        pulls = self._forge.pull_requests("open")
        self._seen_at = self._monotonic()
        self._forget_all_but({pull.number for pull in pulls})
        if fetch_main:
            self._main.fetch()
        if fetch_main or self._catalogue_moved:
            self._refresh()
        for pull in sorted(pulls, key=lambda pull: pull.number):
            waits = pull.number in self._waiting
            if self._settled.get(pull.number) != pull.head or (waits and fetch_main):
                self._try_to_decide(pull)
        if self._main.tip != self._announced:
            self._announce(self._announced, self._main.tip)
        if self._unchecked is not None:
            self._unchecked.read()
            self.statistics.unchecked = self._unchecked.counts

    def _refresh(self) -> None:
        """Read the catalogue; nothing is decided by an old one that is known to have moved."""
        self._catalogue_moved = False  # before it is read: a push that is notified meanwhile is read for itself
        try:
            self._rules.refresh()
        except RobotKubeError:
            self._catalogue_moved = True
            raise

    def _forget_all_but(self, numbers: set[int]) -> None:
        self._waiting &= numbers
        for known in (self._settled, self._first_lines):
            for number in known.keys() - numbers:
                del known[number]

    def _try_to_decide(self, pull: PullRequest) -> None:
        try:
            self._decide(pull)
        except RobotKubeError as error:
            self.statistics.verdicts["failed"] += 1
            log.error("proposal failed number=%d reason=%s", pull.number, error)

    def _decide(self, pull: PullRequest) -> None:
        started = self._monotonic()
        try:
            case = self._case_of_sent_objects(pull) or self._fetched_case(pull)
        except DocumentError as error:
            self._unreadable(pull, str(error), started)
            return
        if case is None:
            return
        case, pushed = self._joined(case)
        commit = case.commit
        if case.mergeable and not self._still_proposed(case):
            return
        judged = self._monotonic()
        before = self._main.tip
        merged = case.mergeable and self._merge(case, pushed, before)
        verdict = case.verdict
        if case.mergeable and not merged:
            self._main.fetch()
            if pushed != commit.id:  # a person's: joined with main as it is now, in the next round
                self._resync_due = True
                return
            verdict = replace(verdict, stale=True)
        if not merged:
            self._answer(case, verdict)
        decided = self._monotonic()
        newly_decided = merged or self._settled.get(pull.number) != commit.id
        self._settled[pull.number] = commit.id
        if merged:
            for manager in self._managers:
                manager.hook(before, pushed)
            self._announce(before, pushed)
        if newly_decided:
            self._record(case, verdict, merged, (started, judged, decided, self._monotonic()))

    def _joined(self, case: _Case) -> tuple[_Case, str]:
        """A case and the commit that main is moved to if it may be: a plan's own; of a person's pull request, its merge
        into main, which is judged as it would stand there."""
        if not case.mergeable or self._plans(case.pull):
            return case, case.commit.id
        merge = merge_commit(self._main, self._commits, case.pull, case.commit, case.approvers)
        verdict = self._rules.judge(case.pull.author, self._rules.proposal(merge))
        return replace(case, verdict=verdict), merge.id

    def _still_proposed(self, case: _Case) -> bool:
        """Return whether the pull request is open with what was judged: a webhook may come late, and judging takes a
        while, in which whoever proposed it can close it or propose something else."""
        now = self._forge.pull_request(case.pull.number)
        if now.state == "open" and now.head == case.pull.head:
            return True
        log.info("proposal withdrawn number=%d state=%s head=%s", now.number, now.state, now.head[:12])
        return False

    def _plans(self, pull: PullRequest) -> bool:
        """Return whether its author is a manager."""
        return self._settings.proposer(pull.author) is not None

    def _merge(self, case: _Case, commit: str, before: str) -> bool:
        """Move main from `before` to the commit that was checked; False when main has moved meanwhile."""
        if self._unchecked is not None:  # before: a push without an answer may have arrived
            self._unchecked.watch.expect(commit)
        merged = self._push(case, commit, before)
        if not merged and self._unchecked is not None:
            self._unchecked.watch.drop(commit)
        return merged

    def _push(self, case: _Case, commit: str, before: str) -> bool:
        """The same, and have it recorded."""
        if self._recorder is None:
            return self._main.push_main(commit)
        record = self._recorder.expect(case.record(commit, before, self._rules.catalogue_tip))
        try:
            merged = self._main.push_main(commit)
        except RobotKubeError:
            self._recorder.unsure(record)
            raise
        (self._recorder.merged if merged else self._recorder.dropped)(record)
        return merged

    def _unreadable(self, pull: PullRequest, problem: str, started: float) -> None:
        """Refuse a pull request that cannot even be read."""
        self.statistics.verdicts["refused"] += 1
        log.error("proposal unreadable number=%d problem=%r", pull.number, problem)
        self._comment_once(pull.number, verdict_comments.refusal_text(pull.head, [problem]))
        if self._plans(pull):
            self._forge.close(pull.number)
        self._settled[pull.number] = pull.head
        seconds = self._monotonic() - started
        checks = [CheckResult(READABLE, (problem,), seconds)]
        self.decisions.put(Decision(pull.number, pull.author, pull.head, "refused", "", (), checks, seconds))

    def _case_of_sent_objects(self, pull: PullRequest) -> _Case | None:
        """A manager's proposal as the objects that the same manager sent have it; None unless it may be merged. All
        else is judged on what the forge has: here main's tip may be an old one, and a refusal is not proved by any
        push."""
        objects = self._pending_objects.pop(pull.author, pull.head)
        if objects is None or not self._plans(pull):
            return None
        try:
            commit = self._main.receive(objects)
            case = self._case(pull, commit, "sent") if commit is not None else None
        except InputError:
            return None
        return case if case is not None and case.mergeable else None

    def _fetched_case(self, pull: PullRequest) -> _Case | None:
        """The head of a pull request as the forge has it; None when it is in main already."""
        commit = self._main.proposal(pull.number)
        if self._main.contains(commit.id):
            self._settled[pull.number] = commit.id
            return None
        return self._case(pull, commit, "fetched")

    def _case(self, pull: PullRequest, commit: Commit, source: str) -> _Case:
        """Everything that decides about a pull request, read from Git, the catalogue and main; a refusal only after the
        catalogue was read again, since its webhook may have been lost."""
        began = self._monotonic()
        plans = self._plans(pull)
        commit = commit if plans else self._main.changes_since_branch(commit.id)
        proposal = self._rules.proposal(commit, () if plans else self._main.overlaps(commit))
        verdict = self._rules.judge(pull.author, proposal)
        if verdict.problems and self._rules.refresh():
            verdict = self._rules.judge(pull.author, proposal)
        way = AUTOMATIC if verdict.repair else self._rules.way(pull.author, proposal.paths)
        asks = way == APPROVAL and not (plans and not verdict.accepted)
        approved_by = self._approvers(pull, commit) if asks else ()
        return _Case(pull, commit, proposal, verdict, way, approved_by, source, self._monotonic() - began)

    def _approvers(self, pull: PullRequest, commit: Commit) -> tuple[str, ...]:
        """Who approved exactly this commit; the accounts of programs do not count."""
        programs = (*self._settings.accounts, self._settings.account)
        return approvers(self._forge.reviews(pull.number), commit.id, pull.author, programs)

    # -- reporting ------------------------------------------------------------------------------------------------

    def _answer(self, case: _Case, verdict: ProposalVerdict) -> None:
        """Comment why a pull request was not merged. A manager's is closed with that, unless it waits for people; a
        person's stays open."""
        number = case.pull.number
        commit = case.commit
        self._waiting.discard(number)
        if not self._plans(case.pull):
            self._comment_once(number, verdict_comments.checked_text(commit.id, case.proposal, verdict, case.way))
            self._waiting.add(number)
        elif verdict.accepted:
            self._comment_once(number, verdict_comments.waiting_text(commit.id, case.way))
            self._waiting.add(number)
        else:
            parent = commit.parents[0] if commit.parents else ""
            stale = verdict_comments.stale_text(parent, self._main.tip)
            refusal = verdict_comments.refusal_text(commit.id, verdict.problems)
            self._comment_once(number, stale if verdict.stale else refusal)
            self._forge.close(number)

    def _comment_once(self, number: int, text: str) -> None:
        """Comment on a pull request unless a comment with the same first line is there, also from before a
        restart."""
        first = text.partition("\n")[0]
        if number not in self._first_lines:
            own = [c.text for c in self._forge.comments(number) if c.author == self._settings.account]
            self._first_lines[number] = {comment.partition("\n")[0] for comment in own}
        if first not in self._first_lines[number]:
            self._forge.comment(number, text)
            self._first_lines[number].add(first)

    def _announce(self, before: str, after: str) -> None:
        """Notify Argo CD that main moved; what it did not receive is sent again in the next round."""
        if self._push_hook.hook(before or after, after):
            self._announced = after
            self.statistics.hooks["received"] += 1
            log.info("announced before=%s after=%s", before[:12], after[:12])
        else:
            self.statistics.hooks["lost"] += 1

    def _record(self, case: _Case, verdict: ProposalVerdict, merged: bool, at: tuple[float, ...]) -> None:
        started, judged, decided, announced = at
        plans = self._plans(case.pull)
        refusal = "stale" if verdict.stale else "refused" if verdict.problems else "checked"
        name = "accepted" if merged else refusal if plans else "checked"
        self.statistics.verdicts[name] += 1
        self.statistics.sources[case.source] += 1
        self.statistics.decision_seconds += decided - started
        self.decisions.put(
            Decision(
                *(case.pull.number, case.pull.author, case.commit.id, name, case.way, case.approvers),
                verdict.checks,
                decided - started,
            )
        )
        log.info(
            "proposal number=%d author=%s commit=%s verdict=%s way=%s problems=%d source=%s "
            "fetch_ms=%.0f check_ms=%.1f decide_ms=%.0f hook_ms=%.0f subject=%r",
            *(case.pull.number, case.pull.author, case.commit.id[:12], name, case.way, len(verdict.problems)),
            *(case.source, 1000 * (judged - started - case.check_seconds), 1000 * case.check_seconds),
            1000 * (decided - judged),
            1000 * (announced - decided),
            case.commit.message.partition("\n")[0],
        )
