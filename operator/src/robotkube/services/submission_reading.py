"""A submission as it stands against main's tip: its commit checked, its charts pulled and compared with their entries,
results that count already found."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field

from robotkube.domain.charts_packing import PulledChart
from robotkube.domain.errors import DocumentError, InputError
from robotkube.domain.evidence import Artefact
from robotkube.domain.referrers import fallback_tag
from robotkube.domain.registry_sources import Tools
from robotkube.domain.submissions import (
    READ_FOLDERS,
    Proposed,
    Submission,
    SubmittedChart,
    artefact_problems,
    read_submission,
    schema_text,
)
from robotkube.domain.suite_requests import Replaced
from robotkube.domain.texts import read_mapping
from robotkube.domain.verification import PATH as POLICY_PATH
from robotkube.domain.verification import VerificationPolicy, read_verification_policy
from robotkube.ports.git import Commit, MainBranch
from robotkube.ports.registries import ChartRegistry
from robotkube.services.verifying import ChartUnderway, Verifying

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PublicationSettings:
    """`catalogue`: `<organisation>/<name>`; `publishers`: accounts whose submissions are taken; `account`: the gate's
    own; `staging`, `verified`: organisations of the registry; `charts_url`: of the latter, oci://host/organisation;
    `local_builds`: a version may be published again with another digest."""

    catalogue: str
    publishers: tuple[str, ...]
    account: str
    staging: str
    verified: str
    charts_url: str
    local_builds: bool = False


@dataclass
class Underway:
    """A submission at one head, as it stood against main's tip `tip`."""

    number: int
    commit: Commit
    started: float
    tip: str = ""
    submission: Submission = field(default_factory=Submission)
    policy: VerificationPolicy | None = None
    charts: list[ChartUnderway] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    waiting_for: str = ""


class SubmissionReader:
    """Looks at submissions; `tools` are what validation needs."""

    def __init__(
        self,
        main: MainBranch,
        registry: ChartRegistry,
        verifying: Verifying,
        settings: PublicationSettings,
        tools: Tools,
    ) -> None:
        self._main, self._registry, self._verifying = main, registry, verifying
        self._settings, self._tools = settings, tools

    def look(self, underway: Underway) -> None:
        """Check the commit against main's tip; results that still count are kept."""
        tip, commit = self._main.tip, underway.commit
        files = self._main.files(tip, READ_FOLDERS)
        on_main = len(commit.parents) == 1 and self._main.contains(commit.parents[0])
        base = self._main.files(commit.parents[0], READ_FOLDERS) if on_main else {}
        proposed = Proposed(commit.parents, commit.changes, commit.irregular, on_main, base, files)
        submission = self._read(proposed)
        policy = self._read_policy(files)
        before = {chart.chart.path: chart for chart in underway.charts if chart.policy == policy}
        charts: list[ChartUnderway] = []
        problems = list(submission.problems)
        for chart in submission.charts if policy and not problems else ():
            known = before.get(chart.path)
            found, wrong = (known, []) if known else self._begin(chart, policy, underway.commit.id, submission, files)
            problems += wrong
            charts += [found] if found else []
        underway.submission, underway.policy, underway.charts = submission, policy, charts
        underway.problems, underway.tip = problems, tip

    def _read(self, proposed: Proposed) -> Submission:
        try:
            return read_submission(proposed, self._settings.local_builds, self._tools)
        except InputError as error:  # a schema or template that cannot even be tried
            return Submission(problems=(f"a schema of the catalogue with this submission: {error}",))

    def _read_policy(self, files: Mapping[str, str]) -> VerificationPolicy | None:
        try:
            return read_verification_policy(files.get(POLICY_PATH, ""), POLICY_PATH)
        except DocumentError as error:
            log.error("verification policy unusable reason=%s", error)
            return None

    def _begin(
        self,
        chart: SubmittedChart,
        policy: VerificationPolicy | None,
        attempt: str,
        submission: Submission,
        files: Mapping[str, str],
    ) -> tuple[ChartUnderway | None, list[str]]:
        assert policy is not None
        pulled, problems = self._pull(chart)
        if pulled is None or problems:
            return None, problems
        underway = ChartUnderway(chart, schema_text(pulled.files), policy, attempt, self._replaced(chart, files))
        folder = chart.artefact.folder
        carried = [text.encode() for path, text in submission.evidence.items() if path.startswith(f"{folder}/")]
        self._verifying.begin(underway, carried)
        return underway, []

    def lost(self, underway: Underway) -> list[str]:
        """What somebody deleted or broke in staging since the submission was looked at."""
        return [problem for one in underway.charts for problem in self._staging_problems(one.chart)]

    def _staging_problems(self, chart: SubmittedChart) -> list[str]:
        repository = f"{self._settings.staging}/{chart.chart}"
        if self._registry.manifest_digest(repository, chart.digest) is None:
            fix = "push it (`robotkube registry submit` does)"
            return [f"{chart.path}: {repository} has no digest {chart.digest}; {fix}, and write no tag twice"]
        try:  # the publisher writes there too: what is attached may be anything
            self._registry.attachments(repository, chart.digest)
        except InputError as error:
            fix = f"delete the tag {fallback_tag(chart.digest)} of {repository}"
            return [f"{chart.path}: what is attached to it in {repository} cannot be read: {error}; {fix}"]
        return []

    def _pull(self, chart: SubmittedChart) -> tuple[PulledChart | None, list[str]]:
        problems = self._staging_problems(chart)
        if problems:
            return None, problems
        repository = f"{self._settings.staging}/{chart.chart}"
        try:
            pulled = self._registry.pull_chart(repository, chart.digest)
        except InputError as error:
            return None, [f"{chart.path}: {chart.digest} is not a chart that can be read: {error}"]
        return pulled, artefact_problems(chart, pulled)

    def _replaced(self, chart: SubmittedChart, files: Mapping[str, str]) -> Replaced | None:
        """The published version that this one says it replaces."""
        version = chart.spec.get("replaces")
        path = f"charts/{chart.chart}/{version}.yaml"
        if not version or path not in files:
            return None
        document = read_mapping(files[path], path)
        status = document.get("status") or {}
        if status.get("state") != "verified":
            return None
        artefact = Artefact(chart.chart, str(version), str(status.get("digest")), chart.artefact.platform)
        return Replaced(artefact, f"{self._settings.verified}/{chart.chart}", document)
