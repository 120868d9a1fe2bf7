"""A submission as it stands against main's tip: its commit checked, its charts pulled and compared with their entries,
results that still count collected, its applications tried."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.yaml_codec import read_mapping, write_mapping
from robotkube.foundation.forge.ports.repositories import Commit, MainBranch
from robotkube.registry.catalogue.core.sources import Tools
from robotkube.registry.charts.core.packing import PulledChart, build_tag
from robotkube.registry.charts.core.referrers import fallback_tag
from robotkube.registry.charts.ports import ChartRegistry
from robotkube.registry.evidence.core.statements import Artefact
from robotkube.registry.evidence.core.verification_policy import PATH as POLICY_PATH
from robotkube.registry.evidence.core.verification_policy import VerificationPolicy, read_verification_policy
from robotkube.registry.publication.core.approvals import approval_reasons
from robotkube.registry.publication.core.submissions import (
    EVIDENCE,
    OWN_IMAGES,
    READ_FOLDERS,
    Proposed,
    Submission,
    SubmittedChart,
    artefact_problems,
    own_images,
    publisher_place,
    pushed_place,
    read_submission,
    schema_path,
    schema_text,
)
from robotkube.registry.publication.loops.application_verification import ApplicationVerification, TriedApplications
from robotkube.registry.publication.loops.chart_in_progress import ChartInProgress
from robotkube.registry.publication.loops.verification import ChartVerification
from robotkube.registry.suites.core.image_checks import BILL_TYPE
from robotkube.registry.suites.core.requests import Replaced

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PublicationSettings:
    """Settings of the publication. `catalogue`: `<organisation>/<name>`; `publishers`: accounts whose submissions are
    accepted; `account`: the gate's own; `staging`, `verified`: organisations of the OCI registry that the gate alone
    writes, for what it tries and for what it published; `charts_url`: of the latter, oci://host/organisation;
    `local_builds`: a version may be published again with another digest."""

    catalogue: str
    publishers: tuple[str, ...]
    account: str
    staging: str
    verified: str
    charts_url: str
    local_builds: bool = False


@dataclass
class SubmissionInProgress:
    """A submission of `author` at one head, as it stood against main's tip `tip`; `approval`: why it needs a person's
    approval, `approvers` who gave it."""

    number: int
    author: str
    commit: Commit
    started: float
    tip: str = ""
    submission: Submission = field(default_factory=Submission)
    policy: VerificationPolicy | None = None
    charts: list[ChartInProgress] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    approval: tuple[str, ...] = ()
    approvers: tuple[str, ...] = ()
    applications: TriedApplications = field(default_factory=TriedApplications)
    waiting_for: str = ""


class SubmissionReader:
    """Reads and checks submissions; `applications` tries what is composed of them, `tools` are what validation
    needs."""

    def __init__(
        self,
        main: MainBranch,
        oci_registry: ChartRegistry,
        verifying: ChartVerification,
        applications: ApplicationVerification,
        settings: PublicationSettings,
        tools: Tools,
    ) -> None:
        self._main = main
        self._oci_registry = oci_registry
        self._verifying = verifying
        self._applications = applications
        self._settings = settings
        self._tools = tools

    def check(self, underway: SubmissionInProgress) -> None:
        """Check the commit against main's tip; results that still count are kept."""
        tip = self._main.tip
        commit = underway.commit
        files = self._main.files(tip, READ_FOLDERS)
        on_main = len(commit.parents) == 1 and self._main.contains(commit.parents[0])
        base = self._main.files(commit.parents[0], READ_FOLDERS) if on_main else {}
        proposed = Proposed(commit.parents, commit.changes, commit.irregular, on_main, base, files)
        submission = self._read(proposed)
        policy = self._read_policy(files)
        before = {chart.chart.path: chart for chart in underway.charts if chart.policy == policy}
        charts: list[ChartInProgress] = []
        problems = list(submission.problems)
        for chart in submission.charts if policy and not problems else ():
            known = before.get(chart.path)
            begun, wrong = (known, []) if known else self._begin(chart, policy, underway, submission, files)
            problems += wrong
            charts += [begun] if begun else []
        underway.submission = submission
        underway.policy = policy
        underway.charts = charts
        underway.applications = self._try(submission, charts, tip) if policy and not problems else TriedApplications()
        problems += underway.applications.problems
        underway.problems = problems
        underway.approval = () if problems else approval_reasons(submission.applications, files)
        underway.tip = tip

    def _try(self, submission: Submission, charts: Sequence[ChartInProgress], tip: str) -> TriedApplications:
        """Try the applications of a submission, and those that it concerns, as the catalogue will be."""
        main = self._main.files(tip, (*READ_FOLDERS, EVIDENCE))
        after = {**main, **submission.applications}
        for chart in charts:
            path = chart.chart.path
            after |= {path: write_mapping(chart.chart.document), schema_path(path): chart.schema}
        references = {chart.chart.reference for chart in charts}
        return self._applications.tried(main, after, references, unsigned=True)

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
        proposed: SubmissionInProgress,
        submission: Submission,
        files: Mapping[str, str],
    ) -> tuple[ChartInProgress | None, list[str]]:
        assert policy is not None
        pulled, problems = self._pull(chart, proposed.author)
        if pulled is None or problems:
            return None, problems
        replaced = self._replaced(chart, files)
        underway = ChartInProgress(chart, schema_text(pulled.files), policy, proposed.commit.id, replaced)
        folder = chart.artefact.folder
        carried = [text.encode() for path, text in submission.evidence.items() if path.startswith(f"{folder}/")]
        self._verifying.begin(underway, carried)
        return underway, []

    def lost(self, underway: SubmissionInProgress) -> list[str]:
        """Problems of charts that were deleted or broken in staging since the submission was checked."""
        return [problem for chart in underway.charts for problem in self._staging_problems(chart.chart)]

    def _staging_problems(self, chart: SubmittedChart) -> list[str]:
        repository = f"{self._settings.staging}/{chart.chart}"
        if self._oci_registry.manifest_digest(repository, chart.digest) is None:
            return [f"{chart.path}: {repository} has no digest {chart.digest} any more; submit it again"]
        try:  # what publishers attached before they had places of their own may be anything
            self._oci_registry.attachments(repository, chart.digest)
        except InputError as error:
            fix = f"delete the tag {fallback_tag(chart.digest)} of {repository}"
            return [f"{chart.path}: what is attached to it in {repository} cannot be read: {error}; {fix}"]
        return []

    def _pull(self, chart: SubmittedChart, author: str) -> tuple[PulledChart | None, list[str]]:
        """The chart from `staging`, or from its author's place; then it is copied to `staging`, so that what is tried
        and published stays whatever the author pushes or deletes from now on."""
        staging = f"{self._settings.staging}/{chart.chart}"
        place = f"{publisher_place(self._settings.staging, author)}/{chart.chart}"
        places = (where for where in (staging, place) if self._oci_registry.manifest_digest(where, chart.digest))
        source = next(places, "")
        if not source:
            fix = "submit it again (`robotkube registry submit` pushes it there), and write no tag twice"
            return None, [f"{chart.path}: {place} has no digest {chart.digest}; {fix}"]
        try:
            pulled = self._oci_registry.pull_chart(source, chart.digest)
        except InputError as error:
            return None, [f"{chart.path}: {chart.digest} is not a chart that can be read: {error}"]
        problems = artefact_problems(chart, pulled)
        if source == place and not problems:
            self._oci_registry.copy_chart(place, staging, chart.digest, build_tag(chart.version, chart.digest), ())
        return pulled, problems or self._staging_problems(chart) or list(self._image_problems(chart, author))

    def _image_problems(self, chart: SubmittedChart, author: str) -> Iterator[str]:
        """Copy the author's own images from its place to where nodes pull them; why one is in neither."""
        for name, digest in own_images(chart.images):
            source, target = f"{pushed_place(self._settings.staging, author)}/{name}", f"{OWN_IMAGES}/{name}"
            try:
                if self._oci_registry.manifest_digest(source, digest):
                    self._oci_registry.copy_image(source, target, digest, BILL_TYPE)
                elif not self._oci_registry.manifest_digest(target, digest):
                    fix = "push it (`robotkube image push`) and submit the chart again"
                    yield f"{chart.path}: image {name}: {source} has no digest {digest}; {fix}"
            except InputError as error:
                yield f"{chart.path}: image {name}: {digest} cannot be copied from {source}: {error}"

    def _replaced(self, chart: SubmittedChart, files: Mapping[str, str]) -> Replaced | None:
        """The first published version of those that this one replaces or skips."""
        for version in (chart.spec.get("replaces"), *chart.spec.get("skips", ())):
            path = f"charts/{chart.chart}/{version}.yaml"
            document = read_mapping(files[path], path) if path in files else {}
            status = document.get("status") or {}
            if status.get("state") == "verified":
                artefact = Artefact(chart.chart, str(version), str(status.get("digest")), chart.artefact.platform)
                return Replaced(artefact, f"{self._settings.verified}/{chart.chart}", document)
        return None
