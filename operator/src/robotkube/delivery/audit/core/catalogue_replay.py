"""The catalogue as it stood at a commit, and what in its history let more through than before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from robotkube.delivery.audit.core.findings import Finding
from robotkube.delivery.audit.core.main_replay import time_findings
from robotkube.delivery.deployment.core.releases import Release
from robotkube.errors import DocumentError
from robotkube.foundation.forge.core.histories import HistoryCommit
from robotkube.registry.catalogue.core.catalogue import (
    APPLICATION_ASSURANCES,
    AUTOMATIC,
    NONE,
    RELEASE_POLICY,
    VERIFICATION_POLICY,
    Catalogue,
    ReleasePolicy,
    read_release_policy,
)
from robotkube.registry.evidence.core.application_statements import statement_path
from robotkube.registry.evidence.core.verification_policy import VerificationPolicy, read_verification_policy

ChartOf = tuple[str, str, str]
"""Chart, version, digest."""


@dataclass(frozen=True)
class CatalogueReplay:
    """Commits of the catalogue's main, oldest first, and findings in what changed."""

    commits: tuple[HistoryCommit, ...] = ()
    findings: tuple[Finding, ...] = ()
    ids: frozenset[str] = field(default_factory=frozenset)

    def at(self, when: int) -> str:
        """The newest commit that was there at a time (seconds since 1970); the first one when none was."""
        there = [commit.id for commit in self.commits if commit.committed <= when]
        return there[-1] if there else (self.commits[0].id if self.commits else "")


def replay_catalogue(commits: Sequence[HistoryCommit], now: int) -> CatalogueReplay:
    """The history of the catalogue; policies that ask for less than before are findings. The first commit is what was
    set up."""
    findings: list[Finding] = []
    release: ReleasePolicy | None = None
    verification: VerificationPolicy | None = None
    before: HistoryCommit | None = None
    for commit in commits:
        findings += time_findings(commit, before, now, "catalogue")
        before = commit
        if RELEASE_POLICY in commit.changes:
            new = _release_policy(commit.changes[RELEASE_POLICY])
            findings += [_relaxed(commit, what) for what in _looser(release, new)]
            release = new or release
        if VERIFICATION_POLICY in commit.changes:
            asked = _verification_policy(commit.changes[VERIFICATION_POLICY])
            findings += [_relaxed(commit, what) for what in _fewer(verification, asked)]
            verification = asked or verification
    return CatalogueReplay(tuple(commits), tuple(findings), frozenset(commit.id for commit in commits))


def _release_policy(text: str | None) -> ReleasePolicy | None:
    try:
        return read_release_policy(text, RELEASE_POLICY) if text else None
    except DocumentError:
        return None


def _verification_policy(text: str | None) -> VerificationPolicy | None:
    try:
        return read_verification_policy(text, VERIFICATION_POLICY) if text else None
    except DocumentError:
        return None


def _looser(before: ReleasePolicy | None, after: ReleasePolicy | None) -> Iterator[str]:
    """Evidence that is not asked for is a finding from the first commit on; the rest when it was asked for before."""
    if after is None:
        return
    if after.assurance == NONE and (before is None or before.assurance != NONE):
        yield f"{RELEASE_POLICY}: assurance none; nothing has to be verified to be deployed"
    if after.initial_for == AUTOMATIC and before is not None and before.initial_for != AUTOMATIC:
        yield f"{RELEASE_POLICY}: initialFor automatic; what runs by itself waits for nobody's approval"
    asked = APPLICATION_ASSURANCES.index(after.applications)
    if before is not None and asked > APPLICATION_ASSURANCES.index(before.applications):
        yield f"{RELEASE_POLICY}: applications {after.applications}; fewer applications have to be checked"
    elif before is None and after.applications == NONE:
        yield f"{RELEASE_POLICY}: applications none; no application has to be checked"


def _fewer(before: VerificationPolicy | None, after: VerificationPolicy | None) -> Iterator[str]:
    """A file that is gone or cannot be read assures nothing, which is no relaxation."""
    names = {rule.name for rule in after.suites} if after else set()
    gone = sorted({rule.name for rule in before.suites} - names) if before and after else []
    if gone:
        yield f"{VERIFICATION_POLICY}: suite {', '.join(gone)} is not asked for any more"


def _relaxed(commit: HistoryCommit, what: str) -> Finding:
    return Finding("policy-relaxed", "catalogue", f"commit {commit.id}", what, commit.id)


def release_finding(release: Release, catalogue: Catalogue, commit: str, decided_by: str) -> Finding | None:
    """What is wrong with the evidence of a release that main got by `commit`, when `catalogue`, at its commit
    `decided_by`, is what the gate decided by; None when nothing is."""
    where = f"release {release.key} by commit {commit}"
    chart = f"{release.chart}@{release.version}"
    about = (release.key,)
    if release.evidence == NONE:
        return Finding("no-evidence", "deployment", where, f"{chart} with evidence none", commit, about)
    version = catalogue.version(release.chart, release.version)
    if version is None or version.digest != release.digest:
        had = f"{version.digest} instead" if version else "none"
        what = f"{chart} {release.digest}: the catalogue at {decided_by[:12]} had {had}"
        return Finding("not-in-catalogue", "deployment", where, what, commit, about)
    problem = version.evidence_problem if not version.assured else ""
    if not problem and version.evidence != release.evidence:
        problem = f"it names {release.evidence}, the evidence of this digest is {version.evidence}"
    if not problem and version.state != "verified":
        problem = f"its state was {version.state}"
    what = f"{chart} {release.digest}: {problem}"
    return Finding("evidence-not-valid", "deployment", where, what, commit, about) if problem else None


def application_findings(release: Release, catalogue: Catalogue, commit: str, decided_by: str) -> Iterator[Finding]:
    """What is wrong with the applications that a release's tasks asked for, in the catalogue that was decided by."""
    for name in sorted({cause.application for cause in release.causes}):
        application = catalogue.applications.get(name)
        problem = (
            f"the catalogue at {decided_by[:12]} had none" if application is None else catalogue.forbids(application)
        )
        if problem:
            tasks = ", ".join(cause.task for cause in release.causes if cause.application == name)
            where = f"release {release.key} by commit {commit}"
            what = f"application {name}, asked for by {tasks}: {problem}"
            yield Finding("application-not-verified", "deployment", where, what, commit, (release.key,))


def earlier_policies(replayed: CatalogueReplay) -> Mapping[str, str]:
    """Every verification policy that main ever had: its digest -> its text."""
    policies: dict[str, str] = {}
    for commit in replayed.commits:
        text = commit.changes.get(VERIFICATION_POLICY)
        policy = _verification_policy(text)
        if policy is not None and text is not None:
            policies[policy.digest] = text
    return policies


def tip_findings(
    catalogue: Catalogue, under: Mapping[str, Catalogue], tip: str, replayed: CatalogueReplay
) -> Iterator[Finding]:
    """What is wrong in the catalogue as it stands: entries that cannot be read, versions and applications whose
    evidence does not hold.

    `under`: digest of an earlier policy -> the same catalogue by it; a version is judged by the policy that it was
    published under. A finding's commit is the last one that changed the entry or its evidence."""
    last = {path: commit.id for commit in replayed.commits for path in commit.paths}
    places = {commit.id: place for place, commit in enumerate(replayed.commits)}
    for problem in catalogue.problems:
        path = problem.partition(":")[0]
        yield Finding("catalogue-not-readable", "catalogue", path, problem, last.get(path, tip))
    for name, application in sorted(catalogue.applications.items()):
        assessed = [one.applications[name] for one in (catalogue, *under.values()) if name in one.applications]
        if any(one.assured for one in assessed) or not catalogue.forbids(application):
            continue
        path = f"applications/{name}.yaml"
        touched = [last[one] for one in (path, statement_path(name)) if one in last]
        newest = max(touched, key=lambda commit: places[commit], default=tip)
        yield Finding("application-not-valid", "catalogue", path, application.evidence_problem, newest, (name,))
    for version in sorted((v for of_chart in catalogue.charts.values() for v in of_chart), key=lambda v: v.reference):
        judged = under.get(version.policy, catalogue).version(version.chart, version.version) or version
        if judged.state != "verified" or judged.assured:
            continue
        path = f"charts/{version.chart}/{version.version}"
        parts = (f"{path}.yaml", f"{path}.schema.json", f"evidence/{version.chart}/{version.version}_")
        touched = [commit for name, commit in last.items() if name.startswith(parts)]
        newest = max(touched, key=lambda commit: places[commit], default=tip)
        about = (str(version.reference), version.digest)
        yield Finding("entry-not-valid", "catalogue", f"{path}.yaml", judged.evidence_problem, newest, about)
