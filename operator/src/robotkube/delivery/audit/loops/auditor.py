"""The audit: it reads both repositories, the registry and the keys once, and answers from what it read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from robotkube.delivery.audit.core import report
from robotkube.delivery.audit.core.catalogue_replay import (
    CatalogueReplay,
    application_findings,
    earlier_policies,
    release_finding,
    replay_catalogue,
    tip_findings,
)
from robotkube.delivery.audit.core.findings import Finding, unique
from robotkube.delivery.audit.core.made_good import made_good, with_ends
from robotkube.delivery.audit.core.main_replay import MainReplay, replay
from robotkube.delivery.audit.core.merge_checks import Merges, check_merges, main_moves, without_record
from robotkube.delivery.audit.core.outcomes import read_outcomes
from robotkube.delivery.audit.core.policy_requests import PolicyRequests
from robotkube.delivery.audit.core.questions import Known, answer
from robotkube.delivery.audit.core.verifications import application_row, verification_row
from robotkube.delivery.audit.ports import Manifests
from robotkube.delivery.deployment.core.break_glass import ACCEPTED_PATH, SIGNERS_PATH
from robotkube.delivery.deployment.core.merge_records import OUTCOMES_REFERENCE, REFERENCE
from robotkube.delivery.deployment.core.unchecked_commits import (
    GlassClaim,
    Holds,
    UncheckedCommit,
    judge_claim,
    last_checked,
    says_break_glass,
)
from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.patterns import COMMIT
from robotkube.foundation.forge.core.histories import HistoryCommit
from robotkube.foundation.forge.ports.histories import RepositoryHistory
from robotkube.registry.catalogue.core.catalogue import FOLDERS, VERIFICATION_POLICY, Catalogue
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.loops.verified_catalogue import EvidenceReader
from robotkube.registry.charts.core.packing import build_tag
from robotkube.registry.charts.core.references import ChartReference
from robotkube.registry.evidence.core.application_statements import statement_path
from robotkube.registry.evidence.core.statements import FOLDER, VerifiedStatement
from robotkube.registry.evidence.ports import Verifier

CATALOGUES_CACHED_MAX = 64
FILES_CACHED_MAX = 4
POLICIES = "policies"


@dataclass(frozen=True)
class Sources:
    """What an audit reads. `registry_name` says in words which registry `manifests` are of; both are left out when
    there is none to ask. `holds` checks people's signatures over commits of `repository`. `since`: commits that the
    caller knows to have been on one of both mains; `former`: tips that an earlier copy in the same place had."""

    deployment: RepositoryHistory
    catalogue: RepositoryHistory
    verifier: Verifier
    holds: Holds
    manifests: Manifests | None = None
    registry_name: str = ""
    since: Sequence[str] = ()
    former: Sequence[str] = ()
    progress: Callable[[str], None] = field(default=lambda text: None)
    repository: str = "robotkube/deployment"


class Auditor:
    """One audit; `now` is the present time in seconds since 1970."""

    def __init__(self, sources: Sources, now: int) -> None:
        self._sources = sources
        self._now = now
        self._reader = EvidenceReader(sources.verifier)
        self._catalogue = lru_cache(CATALOGUES_CACHED_MAX)(self._read_catalogue)
        self._files = lru_cache(FILES_CACHED_MAX)(self._read_files)

    def audit(self, word: str) -> report.Row:
        """The document about `word`, or about all of main when it is empty. InputError: nothing on main has to do with
        it, or something cannot be read; UnavailableError: the registry does not answer."""
        sources = self._sources
        keys = sorted(sources.verifier.trusted())
        if not keys:
            raise InputError("--keys: there is no public key (*.pem) in that folder, so nothing can be believed")
        records = sources.deployment.notes(REFERENCE)
        statements = {commit: self._verify(text.removesuffix("\n")) for commit, text in records.texts.items()}
        moves = main_moves(statements)
        commits = sources.deployment.commits(moves)
        if not commits:
            raise InputError("the deployment repository has no main branch: nothing ever ran")
        sources.progress(f"deployment repository: {len(commits)} commits")
        brought = {c.id: sources.deployment.brought(c.id) for c in commits if len(c.parents) > 1 and c.id not in moves}
        offered = replay_catalogue(sources.catalogue.commits({}), self._now)
        sources.progress(f"catalogue: {len(offered.commits)} commits")
        notes = sources.deployment.notes(OUTCOMES_REFERENCE)
        merges = check_merges(commits, statements, records, notes, offered.ids)
        main = replay(commits, brought, self._break_glass(commits, merges), self._now)
        outcomes = read_outcomes(notes, main.changes)
        versions = self._versions(main, merges, offered)
        known = Known(main, {d: v.image_references for d, v in versions.items() if v}, outcomes.by_commit)
        answered = answer(word, known)
        runs = MainReplay(answered.changes, answered.runs)
        ends = made_good(main.changes, merges.records)
        findings = [*with_ends(main.findings, ends), *merges.findings, *outcomes.findings, *offered.findings]
        findings += self._evidence(main, merges, offered)
        findings += self._tip(offered)
        findings += self._registry(main)
        kept, accepted = self._since(unique(findings), commits, offered)
        scope = report.AuditScope(
            deployment=commits[-1].id,
            deployment_commits=len(commits),
            catalogue=offered.commits[-1].id if offered.commits else "",
            catalogue_commits=len(offered.commits),
            keys=tuple(keys),
            registry=sources.registry_name,
            since=tuple(sources.since),
            at=self._now,
        )
        verified = self._verified(runs, merges, offered)
        applications = self._applications(runs, merges, offered)
        requests = PolicyRequests(
            commits, offered.commits, merges, lambda commit: self._decided_by(commit, merges, offered), self._catalogue
        )
        return report.document(
            answered, merges, outcomes, verified, applications, kept, accepted, scope, requests.rows, ends
        )

    def _break_glass(self, commits: Sequence[HistoryCommit], merges: Merges) -> Mapping[str, UncheckedCommit]:
        """The commits without a record that say that they are break-glass, and whether people signed them."""
        sources = self._sources
        unchecked = without_record(commits, merges.records)
        order = [commit.id for commit in commits]
        judged = {}
        for place, commit in enumerate(commits):
            if commit.id not in unchecked or not says_break_glass(commit.message):
                continue
            base = last_checked(order, place, unchecked)
            signers = sources.deployment.files(base, (POLICIES,)).get(SIGNERS_PATH, "") if base else ""
            protected = tuple(path for path in (SIGNERS_PATH, ACCEPTED_PATH) if path in commit.paths)
            claim = GlassClaim(commit.id, sources.repository, commit.parents, commit.tree, commit.message, protected)
            judged[commit.id] = judge_claim(claim, signers, sources.holds)
        return judged

    def _verify(self, text: str) -> VerifiedStatement | str:
        try:
            return self._sources.verifier.verify(text.encode("utf-8", "surrogatepass"))
        except InputError as error:
            return str(error)

    # -- the catalogue --------------------------------------------------------------------------------------------

    def _read_catalogue(self, commit: str, policy: str = "") -> Catalogue:
        """The catalogue at a commit with its evidence assessed, by another verification `policy` when one is given."""
        if not commit:
            return Catalogue()
        files = self._files(commit)
        return self._reader.read({**files, VERIFICATION_POLICY: policy} if policy else files)

    def _read_files(self, commit: str) -> Mapping[str, str]:
        return self._sources.catalogue.files(commit, FOLDERS)

    def _decided_by(self, commit: HistoryCommit, merges: Merges, offered: CatalogueReplay) -> str:
        """The commit of the catalogue that the gate decided by; without a record the newest one of that time."""
        record = merges.records.get(commit.id)
        if record and record.catalogue in offered.ids:
            return record.catalogue
        return offered.at(commit.committed)

    def _evidence(self, main: MainReplay, merges: Merges, offered: CatalogueReplay) -> Iterator[Finding]:
        for change in main.changes:
            releases = [pair.after for pair in change.changed if pair.after]
            if not releases:
                continue
            decided_by = self._decided_by(change.commit, merges, offered)
            for release in releases:
                catalogue = self._catalogue(decided_by)
                finding = release_finding(release, catalogue, change.commit.id, decided_by)
                if finding is not None:
                    yield finding
                yield from application_findings(release, catalogue, change.commit.id, decided_by)

    def _tip(self, offered: CatalogueReplay) -> Iterator[Finding]:
        if not offered.commits:
            yield Finding("catalogue-not-readable", "catalogue", "main", "the catalogue has no main branch")
            return
        tip = offered.commits[-1].id
        by_policy = {d: self._catalogue(tip, text) for d, text in earlier_policies(offered).items()}
        yield from tip_findings(self._catalogue(tip), by_policy, tip, offered)

    def _versions(
        self, main: MainReplay, merges: Merges, offered: CatalogueReplay
    ) -> Mapping[str, ChartVersion | None]:
        """Chart digest -> the version that the catalogue had of it when a release came to main with it."""
        versions: dict[str, ChartVersion | None] = {}
        for change in main.changes:
            for pair in change.changed:
                release = pair.after
                if release is None or versions.get(release.digest):
                    continue
                catalogue = self._catalogue(self._decided_by(change.commit, merges, offered))
                version = catalogue.version(release.chart, release.version)
                versions[release.digest] = version if version and version.digest == release.digest else None
        return versions

    def _verified(self, runs: MainReplay, merges: Merges, offered: CatalogueReplay) -> list[report.Row]:
        """A row for each chart, digest and evidence that the runs name, by the catalogue of its first run."""
        commits = {change.commit.id: change.commit for change in runs.changes}
        rows: dict[tuple[str, ...], report.Row] = {}
        for run in runs.runs:
            release = run.release
            key = (release.chart, release.version, release.digest, release.evidence)
            if key in rows or run.began not in commits:
                continue
            decided_by = self._decided_by(commits[run.began], merges, offered)
            version = self._catalogue(decided_by).version(release.chart, release.version)
            chart = ChartReference(release.chart, release.version, release.digest)
            rows[key] = verification_row(
                chart, release.evidence, version, self._statements(chart, decided_by), decided_by
            )
        return [rows[key] for key in sorted(rows)]

    def _applications(self, runs: MainReplay, merges: Merges, offered: CatalogueReplay) -> list[report.Row]:
        """A row for each application that a task of the runs asked for, by the catalogue of its first run."""
        commits = {change.commit.id: change.commit for change in runs.changes}
        rows: dict[str, report.Row] = {}
        for run in runs.runs:
            for name in sorted({cause.application for cause in run.release.causes} - rows.keys()):
                if run.began in commits:
                    decided_by = self._decided_by(commits[run.began], merges, offered)
                    known = self._catalogue(decided_by).applications.get(name)
                    text = self._files(decided_by).get(statement_path(name)) if decided_by else None
                    statement = self._verify(text) if text is not None else None
                    rows[name] = application_row(name, known, statement, decided_by)
        return [rows[name] for name in sorted(rows)]

    def _statements(self, chart: ChartReference, commit: str) -> Mapping[str, VerifiedStatement | str]:
        if not commit:
            return {}
        folder = f"{FOLDER}/{chart.name}/{build_tag(chart.version, chart.digest)}/"
        texts = {
            path.removeprefix(folder): text for path, text in self._files(commit).items() if path.startswith(folder)
        }
        return {
            name.removesuffix(".json"): self._verify(text) for name, text in texts.items() if name.endswith(".json")
        }

    # -- the registry ---------------------------------------------------------------------------------------------

    def _registry(self, main: MainReplay) -> Iterator[Finding]:
        """Charts that releases ran and that the registry does not have as they were."""
        manifests = self._sources.manifests
        if manifests is None:
            return
        charts = {(run.url, run.release.chart, run.release.version, run.release.digest) for run in main.runs if run.url}
        for url, chart, version, digest in sorted(charts):
            repository = url.removeprefix("oci://").partition("/")[2]
            tag = build_tag(version, digest)
            about = (f"{chart}@{version}@{digest}", digest)
            where = f"{repository}@{digest}"
            try:
                if manifests.manifest(repository, digest) is None:
                    yield Finding("chart-missing", "registry", where, "there is no manifest of this digest", "", about)
                manifest = manifests.manifest(repository, tag)
            except InputError as error:
                yield Finding("manifest-differs", "registry", where, str(error), "", about)
                continue
            yield from _tag(f"{repository}:{tag}", manifest, digest, about)

    # -- what the caller knew -------------------------------------------------------------------------------------

    def _since(
        self, findings: Sequence[Finding], commits: Sequence[HistoryCommit], offered: CatalogueReplay
    ) -> tuple[Sequence[Finding], int]:
        """The findings that came after the commits that the caller knows, and how many others there are; commits that
        are on neither main any more are findings themselves."""
        places = {c.id: place for mains in (commits, offered.commits) for place, c in enumerate(mains)}
        lost = [
            Finding("main-rewritten", "deployment", f"commit {commit}", "neither main has it any more", commit)
            for commit in dict.fromkeys([*self._sources.since, *self._sources.former])
            if commit not in places
        ]
        known = {"deployment": -1, "catalogue": -1}
        deployed = {commit.id for commit in commits}
        for commit in self._sources.since:
            if not COMMIT.fullmatch(commit):
                raise InputError(f"--since {commit!r}: must be a commit of 40 hex, as an audit prints tips")
            if commit in places:
                place = "deployment" if commit in deployed else "catalogue"
                known[place] = max(known[place], places[commit])
        kept = [f for f in findings if not (f.commit in places and places[f.commit] <= known.get(f.place, -1))]
        return [*lost, *kept], len(findings) - len(kept)


def _tag(where: str, manifest: bytes | None, digest: str, about: tuple[str, ...]) -> Iterator[Finding]:
    if manifest is None:
        yield Finding("tag-moved", "registry", where, "the tag is gone", "", about)
    elif sha256(manifest) != digest:
        yield Finding("tag-moved", "registry", where, f"it leads to {sha256(manifest)}, not {digest}", "", about)
