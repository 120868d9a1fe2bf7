"""The gate's publication loop: submissions to the catalogue repository are checked, verified, and published or refused.

Level-triggered: a round reads the open pull requests of publishers, does for each what can be done now, and never
waits for a suite. The order is: copy to `staging`, where no publisher writes; run the suites on that; sign, attach to
the chart's digest, copy chart and evidence to `verified`, push the publication commit to main. That push is the
publication: whatever was done before it is read again or does no harm, so a gate that was killed anywhere goes on in
its next start. What people propose, who are no publishers, is checked and merged by `changes`.
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.backoffs import Random, backoff
from robotkube.errors import DocumentError, InputError, RobotKubeError, UnavailableError
from robotkube.foundation.forge.core.reviews import approvers
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest
from robotkube.foundation.forge.ports.repositories import Commit, Commits, MainBranch
from robotkube.foundation.runtime.ports import Series, by_one
from robotkube.registry.catalogue.core.sources import Tools
from robotkube.registry.charts.ports import ChartRegistry
from robotkube.registry.evidence.core.statements import SuiteResult
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY_PATH
from robotkube.registry.evidence.ports import Signer
from robotkube.registry.publication.core.report import CHECKING, REFUSED, UNCHANGED, VERIFIED, WAITING
from robotkube.registry.publication.core.submissions import KEYS, publication_files, publication_message
from robotkube.registry.publication.loops.application_verification import ApplicationVerification
from robotkube.registry.publication.loops.changes import ChangesOfPeople
from robotkube.registry.publication.loops.chart_in_progress import ChartInProgress
from robotkube.registry.publication.loops.own_image_copies import OwnImageCopies
from robotkube.registry.publication.loops.report_comments import ReportComments
from robotkube.registry.publication.loops.submission_reader import (
    PublicationSettings,
    SubmissionInProgress,
    SubmissionReader,
)
from robotkube.registry.publication.loops.verification import ChartVerification

POLL_SECONDS = 2.0  # open submissions, when no webhook came
BUSY_SECONDS = 0.5  # while suites run
FAILURE_SECONDS_MAX = 4.0  # the longest pause after rounds that failed
SILENT_SECONDS_MAX = 30.0  # not ready when the forge was not seen for longer
VERDICTS = ("published", "refused", "unchanged", "failed")
WAKING_ACTIONS = frozenset({"opened", "reopened", "synchronized", "reviewed"})

log = logging.getLogger(__name__)


@dataclass
class PublicationStatistics:
    """Counted since the start; suites that ran (not kept results): their seconds and how often, by suite."""

    verdicts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(VERDICTS, 0))
    suite_seconds: dict[str, float] = field(default_factory=dict)
    suite_runs: dict[str, int] = field(default_factory=dict)

    def count(self, result: SuiteResult) -> None:
        """A suite came to its end."""
        self.suite_seconds[result.suite] = self.suite_seconds.get(result.suite, 0.0) + result.seconds
        self.suite_runs[result.suite] = self.suite_runs.get(result.suite, 0) + 1


class PublicationLoop:
    """One loop for one catalogue repository; `run` on one thread, `wake` from any.

    `tools` are what validation needs; `published` is called after every push to main; `monotonic` is a clock in seconds
    that never goes back."""

    def __init__(
        self,
        forge: Forge,
        main: MainBranch,
        commits: Commits,
        oci_registry: ChartRegistry,
        verifying: ChartVerification,
        applications: ApplicationVerification,
        signer: Signer,
        settings: PublicationSettings,
        tools: Tools,
        monotonic: Callable[[], float],
        published: Callable[[], None] = lambda: None,
        jitter: Random = random.random,
    ) -> None:
        self._forge = forge
        self._jitter = jitter
        self._main = main
        self._commits = commits
        self._verifying = verifying
        self._applications = applications
        self._signer = signer
        self._settings = settings
        self._monotonic = monotonic
        self._published = published
        self.statistics = PublicationStatistics()
        self._underway: dict[int, SubmissionInProgress] = {}
        self._settled: dict[int, str] = {}
        self._comments = ReportComments(forge, settings)
        self._reader = SubmissionReader(main, oci_registry, verifying, applications, settings, tools)
        self._copies = OwnImageCopies(main, oci_registry)
        self._people = ChangesOfPeople(forge, main, commits, applications, settings, tools, monotonic, published)
        self._people_woken = True
        self._failed: dict[int, str] = {}
        self._key_written = False
        self._woken = threading.Event()
        self._seen_at = monotonic() - SILENT_SECONDS_MAX - 1

    # -- waking ---------------------------------------------------------------------------------------------------

    def wake(self, event: str, payload: Mapping[str, Any]) -> None:
        """A signed delivery of the forge; only decides whether the next round comes now."""
        repository = (payload.get("repository") or {}).get("full_name")
        proposed = event.startswith("pull_request") and payload.get("action") in WAKING_ACTIONS
        if repository == self._settings.catalogue and proposed:
            self._people_woken = True
            self._woken.set()

    def stop(self, stopping: threading.Event) -> None:
        """End `run` after the round that is under way."""
        stopping.set()
        self._woken.set()

    def reasons_not_ready(self) -> list[str]:
        """Empty when the catalogue's pull requests were seen lately."""
        silent = self._monotonic() - self._seen_at
        return [f"the catalogue was not seen for {silent:.0f} s"] if silent > SILENT_SECONDS_MAX else []

    def run(self, stopping: threading.Event) -> None:
        """Rounds until `stopping` is set; errors of forge, OCI registry and suite-runner are logged, and the next round
        tries again."""
        failures = 0
        while not stopping.is_set():
            self._woken.clear()
            try:
                self.round()
                failures = 0
            except RobotKubeError as error:
                failures += 1
                log.error("publication round failed reason=%s", error)
            self._woken.wait(self._pause(failures))

    def _pause(self, failures: int) -> float:
        """Seconds until the next round, unless somebody wakes it: more, and not all the same, after failures."""
        busy = any(not underway.waiting_for for underway in self._underway.values())
        usual = BUSY_SECONDS if busy else POLL_SECONDS
        return backoff(failures - 1, usual, FAILURE_SECONDS_MAX, self._jitter) if failures else usual

    # -- one round ------------------------------------------------------------------------------------------------

    def round(self) -> None:
        """Do for every open submission, oldest first, what can be done now."""
        self._write_key()
        open_pulls = [
            pull for account in self._settings.publishers for pull in self._forge.pull_requests("open", account)
        ]
        self._seen_at = self._monotonic()
        pulls = {pull.number: pull for pull in open_pulls if pull.author in self._settings.publishers}
        for known in (self._underway, self._settled, self._failed):
            for number in set(known) - set(pulls):
                del known[number]
        self._comments.keep(pulls)
        self._copies.keep(pulls)
        for number in sorted(pulls):
            if self._settled.get(number) != pulls[number].head:
                self._try(pulls[number])
        self._copies.clear()
        woken = self._people_woken
        self._people_woken = False  # before it is read: what is notified meanwhile is read for itself
        self._people.round(woken)

    def _try(self, pull: PullRequest) -> None:
        try:
            self._advance(pull)
        except UnavailableError as error:
            log.warning("submission waits number=%d reason=%s", pull.number, error)
            self._wait(pull.number, str(error))
        except Exception as error:  # whatever a submission does to its checks, the others go on
            if isinstance(error, InputError) and self._refuse_if_lost(pull.number):
                return
            if self._failed.get(pull.number) != str(error):  # tried again every round, logged once
                self._failed[pull.number] = str(error)
                self.statistics.verdicts["failed"] += 1
                expected = isinstance(error, RobotKubeError)
                text = error if expected else f"{type(error).__name__}: {error}"
                log.error("submission failed number=%d reason=%s", pull.number, text, exc_info=not expected)
            self._wait(pull.number, f"{error}; somebody who runs the platform has to examine this")

    def _refuse_if_lost(self, number: int) -> bool:
        """Refuse a submission whose charts are no longer in staging as they were; whether that is so."""
        underway = self._underway.get(number)
        try:
            lost = self._reader.lost(underway) if underway else []
            if underway and lost:
                underway.problems = lost
                self._end(underway, REFUSED)
        except RobotKubeError as error:
            log.warning("submission cannot be checked number=%d reason=%s", number, error)
            return False
        return bool(lost)

    def _wait(self, number: int, reason: str) -> None:
        underway = self._underway.get(number)
        if underway is None:
            return
        underway.waiting_for = reason
        try:
            self._comments.report(underway, WAITING)
        except RobotKubeError as error:
            log.warning("submission cannot be reported number=%d reason=%s", number, error)

    def _advance(self, pull: PullRequest) -> None:
        underway = self._underway.get(pull.number)
        if underway is None or underway.commit.id != pull.head:
            try:
                commit = self._main.proposal(pull.number)
            except DocumentError as error:
                unread = Commit(pull.head, (), "", "", {}, ())
                self._end(self._begin(pull, unread, [str(error)]), REFUSED)
                return
            if self._main.contains(commit.id):
                self._settled[pull.number] = commit.id
                return
            underway = self._underway[pull.number] = self._begin(pull, commit, [])
        if underway.policy is None:  # a person may have repaired it meanwhile
            self._main.fetch()
        if underway.tip != self._main.tip or underway.policy is None:
            self._reader.check(underway)
            self._copies.note(underway.number, underway.submission)
        if underway.policy is not None and not underway.problems:
            self._verify(underway)
        underway.waiting_for = self._policy_problem(underway) or self._approval_missing(underway, pull)
        self._decide(underway)

    def _verify(self, underway: SubmissionInProgress) -> None:
        """Go on with the suites. What one chart is refused for without a test namespace keeps all from holding one."""
        for chart in underway.charts:
            self._count(underway, chart, self._verifying.ask(chart))
        if not _plainly_wrong(underway):
            for chart in underway.charts:
                self._count(underway, chart, self._verifying.start(chart))

    def _count(self, underway: SubmissionInProgress, chart: ChartInProgress, results: Sequence[SuiteResult]) -> None:
        for result in results:
            self.statistics.count(result)
            log.info(
                "suite finished number=%d chart=%s suite=%s outcome=%s seconds=%.1f",
                *(underway.number, chart.chart.chart, result.suite, result.outcome, result.seconds),
            )

    def _begin(self, pull: PullRequest, commit: Commit, problems: list[str]) -> SubmissionInProgress:
        return SubmissionInProgress(pull.number, pull.author, commit, self._monotonic(), problems=problems)

    @staticmethod
    def _policy_problem(underway: SubmissionInProgress) -> str:
        return "" if underway.policy else f"{POLICY_PATH} on main of the catalogue cannot be read; a person repairs it"

    def _approval_missing(self, underway: SubmissionInProgress, pull: PullRequest) -> str:
        """What a submission whose suites all passed waits for; empty when somebody else approved exactly this commit,
        or need not. Who did is kept for the commit of the publication."""
        if underway.problems or not underway.approval or not all(chart.passed for chart in underway.charts):
            return ""
        machines = (*self._settings.publishers, self._settings.account)
        underway.approvers = approvers(self._forge.reviews(pull.number), underway.commit.id, pull.author, machines)
        if underway.approvers:
            return ""
        reasons = "; ".join(underway.approval)
        return f"{reasons}. Somebody with write rights who is no publisher reviews this pull request and approves it"

    def _decide(self, underway: SubmissionInProgress) -> None:
        if underway.waiting_for:
            self._comments.report(underway, WAITING)
        elif underway.problems:
            self._refuse(underway)
        elif any(chart.awaited(starting=not _plainly_wrong(underway)) for chart in underway.charts):
            self._comments.report(underway, CHECKING)
        elif not all(chart.passed for chart in underway.charts):
            self._refuse(underway)
        else:
            self._publish(underway)

    # -- verdicts -------------------------------------------------------------------------------------------------

    def _publish(self, underway: SubmissionInProgress) -> None:
        self._main.fetch()
        if self._main.tip != underway.tip:
            return  # main moved: the next round checks the submission again
        verified = [self._verifying.publish(chart) for chart in underway.charts]
        files = publication_files(underway.submission, verified)
        files |= self._applications.statements(underway.applications)
        present = self._main.files(underway.tip, tuple({path.split("/", 1)[0] for path in files}))
        changes: dict[str, str | None] = {path: text for path, text in files.items() if present.get(path) != text}
        if not changes:
            self._end(underway, UNCHANGED)
            return
        self._comments.report(underway, VERIFIED)
        message = publication_message(underway.submission, verified, underway.number, underway.approvers)
        commit = self._commits.commit(underway.tip, changes, message, underway.commit.id, underway.author)
        if not self._main.push_main(commit):
            self._main.fetch()
            return
        self._record(underway, "published")
        self._published()

    def _refuse(self, underway: SubmissionInProgress) -> None:
        for chart in underway.charts:
            self._verifying.attach_results(chart)
        self._end(underway, REFUSED)

    def _end(self, underway: SubmissionInProgress, verdict: str) -> None:
        self._copies.release(underway.number)
        self._copies.clear()  # while it is open: a gate that is killed now does all of this again
        self._comments.report(underway, verdict)
        self._forge.close(underway.number)
        self._record(underway, verdict)

    def _record(self, underway: SubmissionInProgress, verdict: str) -> None:
        self._settled[underway.number] = underway.commit.id
        self._underway.pop(underway.number, None)
        self._copies.release(underway.number)
        self.statistics.verdicts[verdict] += 1
        charts = underway.charts
        log.info(
            "submission number=%d commit=%s verdict=%s charts=%d kept=%d run=%d problems=%d seconds=%.2f subject=%r",
            *(underway.number, underway.commit.id[:12], verdict, len(charts)),
            *(sum(len(chart.kept) for chart in charts), sum(len(chart.results) for chart in charts)),
            *(len(underway.problems), self._monotonic() - underway.started, underway.submission.names),
        )

    # -- the key --------------------------------------------------------------------------------------------------

    def _write_key(self) -> None:
        """Write the public key into the catalogue, for users and other installations; once."""
        if self._key_written:
            return
        tip = self._main.fetch()
        path = f"{KEYS}/{self._signer.key_id}.pem"
        if tip and self._main.files(tip, (KEYS,)).get(path) != self._signer.public_key:
            message = f"publish: key {self._signer.key_id}\n"
            commit = self._commits.commit(tip, {path: self._signer.public_key}, message)
            self._key_written = self._main.push_main(commit)
            log.info("key published key=%s commit=%s", self._signer.key_id, commit[:12])
        else:
            self._key_written = bool(tip)


def _plainly_wrong(underway: SubmissionInProgress) -> bool:
    """Return whether it will be refused for what needs no test namespace to be seen."""
    return any(chart.plainly_wrong for chart in underway.charts)


def publication_metrics(statistics: PublicationStatistics) -> Sequence[Series]:
    """The statistics as metrics."""
    prefix = "robotkube_gate_"
    return (
        Series(
            f"{prefix}publications_total",
            "counter",
            "Decided submissions by verdict.",
            by_one(statistics.verdicts),
            ("verdict",),
        ),
        Series(
            f"{prefix}suite_runs_total",
            "counter",
            "Runs of verification suites; kept results are none.",
            by_one(statistics.suite_runs),
            ("suite",),
        ),
        Series(
            f"{prefix}suite_seconds_total",
            "counter",
            "Time that verification suites took.",
            by_one(statistics.suite_seconds),
            ("suite",),
        ),
    )
