"""Submitting charts and applications: push to the publisher's place, propose to the catalogue, wait for the gate's
decision.

Everything is content-addressed: what the catalogue has already is not submitted again, and the same submission made
twice is one pull request.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from robotkube.backoffs import Random, backoff
from robotkube.errors import AccountRefusedError, InputError, RefusalError, UnavailableError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.foundation.forge.ports.pull_requests import Forge, PullRequest
from robotkube.foundation.forge.ports.repositories import Proposals, RepositoryFiles
from robotkube.registry.charts.core.packing import PackedChart, build_tag
from robotkube.registry.evidence.core.statements import FOLDER as EVIDENCE
from robotkube.registry.publication.core.report import MARKER, UNDECIDED, readable_text
from robotkube.registry.publication.core.report_results import ReportedResult, reported_results
from robotkube.registry.publication.core.submissions import (
    READ_FOLDERS,
    STAGING,
    TOPIC,
    SubmittedChart,
    is_published,
    publisher_place,
)
from robotkube.registry.publication.ports import ChartSource, SubmittedSources

PUBLISHED, UNCHANGED, REFUSED, PLANNED = "published", "unchanged", "refused", "planned"
POLL_SECONDS = 0.5  # at the pull request
RETRY_SECONDS_FIRST = 0.5  # of a forge that does not answer
RETRY_SECONDS_MAX = 5.0
UNAVAILABLE_SECONDS_MAX = 60.0  # the forge may be silent this long
TOPIC_DIGITS = 16

T = TypeVar("T")


class ChartPushing(Protocol):
    """The part of an OCI registry that a publisher uses."""

    def push_chart(self, organisation: str, chart: PackedChart, tag: str = "") -> str:
        """Push to `<organisation>/<chart name>`; the same again changes nothing."""
        ...


@dataclass(frozen=True)
class SubmissionOutcome:
    """How it went. `verdict` is published, unchanged, refused or planned (nothing was written); `text` the gate's
    report for a terminal; `evidence` path in the catalogue -> text of all these charts' evidence."""

    verdict: str
    charts: tuple[SubmittedChart, ...] = ()
    applications: tuple[str, ...] = ()
    unchanged: tuple[str, ...] = ()
    text: str = ""
    number: int = 0
    url: str = ""
    evidence: Mapping[str, str] = field(default_factory=dict)


class Submitting:
    """One publisher at one forge. `account` is the publisher's; `monotonic` and `sleep` are in seconds; `report_line`
    gets progress, a line at a time; `opened` is called with the pull request before its decision is waited for.
    `report_result` gets each suite's result as it comes; progress is without lines of suites then."""

    def __init__(
        self,
        catalogue: RepositoryFiles,
        proposals: Proposals,
        forge: Forge,
        oci_registry: ChartPushing,
        account: str,
        monotonic: Callable[[], float],
        sleep: Callable[[float], None],
        report_line: Callable[[str], None] = lambda line: None,
        opened: Callable[[PullRequest], None] = lambda pull: None,
        jitter: Random = random.random,
        report_result: Callable[[ReportedResult], None] | None = None,
    ) -> None:
        self._catalogue = catalogue
        self._proposals = proposals
        self._forge = forge
        self._oci_registry = oci_registry
        self._account = account
        self._monotonic = monotonic
        self._sleep = sleep
        self._report_line = report_line
        self._opened = opened
        self._jitter = jitter
        self._report_result = report_result

    def submit(
        self, sources: SubmittedSources, wait_seconds: float, dry_run: bool = False, again: bool = False
    ) -> SubmissionOutcome:
        """Submit what the catalogue has not, or everything `again`, and wait for the gate's verdict.

        UnavailableError when the forge does not answer, or nothing was decided within `wait_seconds`: the submission
        stands, the same call waits for it again."""
        tip = self._patiently(self._catalogue.fetch)
        main = self._catalogue.files(tip, READ_FOLDERS)
        unchanged = [c for c in sources.charts if not again and is_published(c.submitted, main)]
        new = [chart for chart in sources.charts if chart not in unchanged]
        applications = {path: text for path, text in sources.applications.items() if main.get(path) != text}
        about = SubmissionOutcome(
            PLANNED,
            tuple(chart.submitted for chart in new),
            tuple(sorted(applications)),
            tuple(chart.submitted.name for chart in unchanged),
        )
        for name in about.unchanged:
            self._report_line(f"{name}: published already with this digest")
        changes = _changes(new, applications, sources.kept)
        staged = [chart.submitted.path for chart in new if main.get(chart.submitted.path) == chart.entry]
        if staged:
            raise InputError(
                f"{', '.join(staged)}: main has this as staged already, by somebody else, so it cannot be proposed; "
                "remove it from the catalogue, then submit again"
            )
        if dry_run or not changes:
            verdict = PLANNED if changes else UNCHANGED
            return _outcome(about, verdict, evidence=self._evidence(tip, sources))
        for chart in new:
            self._push(chart)
        pull = self._open(tip, changes, about)
        self._opened(pull)
        return self._wait_for_decision(pull, about, sources, self._monotonic() + wait_seconds)

    def _push(self, chart: ChartSource) -> None:
        packed = chart.packed
        tag = build_tag(packed.version, packed.digest)
        place = publisher_place(STAGING, self._account)
        self._patiently(lambda: self._oci_registry.push_chart(place, packed, tag))
        self._report_line(f"{packed.name} {packed.version}: pushed to {place} as {packed.digest}")

    def _open(self, tip: str, changes: Mapping[str, str], about: SubmissionOutcome) -> PullRequest:
        """The pull request of exactly these changes: the open one, or a new one. A forge that did not answer a push in
        time may have taken it: each time it is looked for first."""
        identifier = sha256(canonical_json(dict(changes))).removeprefix("sha256:")[:TOPIC_DIGITS]
        topic = TOPIC + identifier
        title = f"submit: {_names(about)} ({identifier})"  # forges do not show the topic of an open pull request
        pull = self._find(title)
        if pull is None:
            commit = self._proposals.commit(tip, changes, f"{title}\n")
            pull = self._patiently(lambda: self._find(title) or self._propose(commit, topic, title))
        if pull is None:
            raise UnavailableError(
                f"the forge accepted submission {topic}, but shows no pull request for it; try again"
            )
        self._report_line(f"pull request {pull.url}")
        return pull

    def _propose(self, commit: str, topic: str, title: str) -> PullRequest | None:
        try:
            number = self._proposals.propose(commit, topic, title, "The gate answers below.\n")
        except RefusalError:  # also of what an earlier push has opened meanwhile
            pull = self._find(title)
            if pull is None:
                raise
            return pull
        return self._patiently(lambda: self._forge.pull_request(number)) if number else self._find(title)

    def _find(self, title: str) -> PullRequest | None:
        pulls = self._patiently(lambda: self._forge.pull_requests("open", self._account))
        return next((pull for pull in pulls if pull.title == title and pull.author == self._account), None)

    def _wait_for_decision(
        self, opened: PullRequest, about: SubmissionOutcome, sources: SubmittedSources, end: float
    ) -> SubmissionOutcome:
        printed: set[str | ReportedResult] = set()
        while True:
            pull = self._patiently(lambda: self._forge.pull_request(opened.number))
            text = self._report(opened.number)
            self._write_progress(text, printed)
            if pull.merged or pull.state == "closed":
                break
            if self._monotonic() >= end:
                raise UnavailableError(
                    f"{pull.url}: not decided within the given time; the gate goes on, "
                    "the same command waits for it again"
                )
            self._sleep(POLL_SECONDS)
        verdict = PUBLISHED if pull.merged or self._is_on_main(sources) else REFUSED
        evidence = self._evidence(self._patiently(self._catalogue.fetch), sources) if verdict == PUBLISHED else {}
        text = readable_text(text) if text else "the pull request was closed without a report of the gate\n"
        return _outcome(about, verdict, text=text, number=pull.number, url=pull.url, evidence=evidence)

    def _write_progress(self, text: str, printed: set[str | ReportedResult]) -> None:
        """Report each headline, what the gate waits for, and each chart's suite once per state."""
        if self._report_result is not None:
            self._write_results(text, printed, self._report_result)
        chart = ""
        for line in readable_text(text).splitlines():
            if line.startswith("### "):
                chart = f"{line.strip('# ')}: "
            rows = () if self._report_result else ("| ",)
            shown = line.startswith(("## ", UNDECIDED, *rows)) and not line.startswith(("| suite", "| ---"))
            state = (chart if line.startswith("| ") else "") + line.strip("#| ").replace(" | ", "  ")
            if shown and state not in printed:
                printed.add(state)
                self._report_line(state)

    @staticmethod
    def _write_results(
        text: str, printed: set[str | ReportedResult], report_result: Callable[[ReportedResult], None]
    ) -> None:
        """Report each result that was not there before."""
        for result in reported_results(text):
            if result not in printed:
                printed.add(result)
                report_result(result)

    def _report(self, number: int) -> str:
        comments = self._patiently(lambda: self._forge.comments(number))
        return next(
            (
                comment.text
                for comment in comments
                if comment.text.startswith(MARKER) and comment.author != self._account
            ),
            "",
        )

    def _is_on_main(self, sources: SubmittedSources) -> bool:
        main = self._catalogue.files(self._patiently(self._catalogue.fetch), READ_FOLDERS)
        charts = all(is_published(chart.submitted, main) for chart in sources.charts)
        return charts and all(main.get(path) == text for path, text in sources.applications.items())

    def _evidence(self, tip: str, sources: SubmittedSources) -> dict[str, str]:
        folders = tuple(f"{chart.submitted.artefact.folder}/" for chart in sources.charts)
        files = self._catalogue.files(tip, (EVIDENCE,)) if folders else {}
        return {path: text for path, text in files.items() if path.startswith(folders)}

    def _patiently(self, call: Callable[[], T]) -> T:
        """The call's answer; a forge that does not answer is asked again within UNAVAILABLE_SECONDS_MAX, one that
        refuses the account is not."""
        end = self._monotonic() + UNAVAILABLE_SECONDS_MAX
        failures = 0
        while True:
            try:
                return call()
            except AccountRefusedError:
                raise
            except UnavailableError:
                if self._monotonic() >= end:
                    raise
                self._sleep(backoff(failures, RETRY_SECONDS_FIRST, RETRY_SECONDS_MAX, self._jitter))
                failures += 1


def _outcome(about: SubmissionOutcome, verdict: str, **more: Any) -> SubmissionOutcome:
    return SubmissionOutcome(**{**vars(about), "verdict": verdict, **more})


def _names(about: SubmissionOutcome) -> str:
    names = [chart.name for chart in about.charts]
    names += [f"application {path.removesuffix('.yaml').rpartition('/')[2]}" for path in about.applications]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _changes(new: Sequence[ChartSource], applications: Mapping[str, str], kept: Mapping[str, str]) -> dict[str, str]:
    """Path -> text of the submission."""
    folders = tuple(f"{chart.submitted.artefact.folder}/" for chart in new)
    changes = {f"charts/{chart.packed.name}/{chart.packed.version}.yaml": chart.entry for chart in new}
    if len(changes) != len(new):
        raise InputError("the same chart version was given twice; name each chart once")
    evidence = {path: text for path, text in kept.items() if folders and path.startswith(folders)}
    return {**changes, **applications, **evidence}
