"""The catalogue as values: applications, chart versions, the release policy; reading them, selecting a version.

    applications/<name>.yaml            what can be asked for
    charts/<chart>/<version>.yaml       what exists, in which state, by which digest
    policies/release.yaml               which states may be deployed, what waits for a person
    evidence/...                        signed envelopes: not read here; `with_evidence` gets what they prove

A file that breaks its rules makes that one entry unusable and is named in `Catalogue.problems`; the others stay.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

from robotkube.errors import DocumentError, RefusalError
from robotkube.foundation.documents.core.entry_reader import read_one_of
from robotkube.foundation.documents.core.reader import Reader
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.applications import Application, ChartRequirement, read_application
from robotkube.registry.catalogue.core.chart_versions import ChartVersion, read_chart_version
from robotkube.registry.catalogue.core.guarantees import GuaranteeRequirement, shortfall
from robotkube.registry.catalogue.core.versions import in_range, version_key
from robotkube.registry.evidence.core.application_statements import ApplicationAssessment

__all__ = [
    "ASSURANCES",
    "FOLDERS",
    "Application",
    "Catalogue",
    "ChartRequirement",
    "ChartVersion",
    "ReleasePolicy",
    "read_application",
    "read_catalogue",
    "read_chart_version",
    "read_release_policy",
]

FOLDERS = ("applications", "charts", "policies", "evidence")
RELEASE_POLICY = "policies/release.yaml"
VERIFICATION_POLICY = "policies/verification.yaml"
REASONS_MAX = 20
PERSON, AUTOMATIC = "person", "automatic"
VERIFIED, TRANSITION, NONE = "verified", "transition", "none"
APPLICATION_ASSURANCES = (VERIFIED, TRANSITION, NONE)
"""Which applications may be deployed: those whose evidence holds; those and such as have none, which an older gate
published; all of them."""
ASSURANCES: Mapping[str, frozenset[str]] = {
    "none": frozenset({"staged", "verified"}),
    "verified": frozenset({"verified"}),
}

Pin = tuple[str, str]
"""Chart and version."""


class EvidenceAssessment(Protocol):
    """An assessment of the evidence of one chart version."""

    @property
    def assured(self) -> bool:
        """Every suite of the policy passed on this digest, signed by a trusted key."""

    @property
    def problems(self) -> Sequence[str]:
        """Why not."""

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        """What each suite found, and who signed it."""


@dataclass(frozen=True)
class Catalogue:
    """Everything that can be selected, at one commit of the catalogue repository. `assurance` is what the release
    policy asks of charts, `application_assurance` (of APPLICATION_ASSURANCES) what it asks of applications."""

    applications: Mapping[str, Application] = field(default_factory=dict)
    charts: Mapping[str, tuple[ChartVersion, ...]] = field(default_factory=dict)
    assurance: str = "verified"
    problems: tuple[str, ...] = ()
    application_assurance: str = TRANSITION

    def bridge(self, kind: str) -> Application:
        """The application whose service bridges links of that kind; RefusalError when there is not exactly one, or when
        the release policy forbids it."""
        bridges = [a for a in self.applications.values() if kind in a.bridges]
        if len(bridges) != 1:
            names = ", ".join(sorted(a.name for a in bridges)) or "none does"
            raise RefusalError("CompositionFailed", f"exactly one application must provide link/{kind}; {names}")
        self.admit(bridges[0])
        return bridges[0]

    def forbids(self, application: Application) -> str:
        """Why the release policy forbids to deploy what an application asks for; empty when it allows it."""
        if application.assured or self.application_assurance == NONE:
            return ""
        if self.application_assurance == TRANSITION and not application.evidence:
            return ""
        return f"no valid evidence: {application.evidence_problem}"

    def admit(self, application: Application) -> None:
        """RefusalError(ApplicationNotVerified) when the release policy forbids the application."""
        if obstacle := self.forbids(application):
            raise RefusalError("ApplicationNotVerified", f"application {application.name}: {obstacle}")

    def version(self, chart: str, version: str) -> ChartVersion | None:
        """One version of a chart; None when there is none."""
        return next((candidate for candidate in self.charts.get(chart, ()) if candidate.version == version), None)

    def with_evidence(
        self,
        assessments: Mapping[tuple[str, str], EvidenceAssessment],
        applications: Mapping[str, ApplicationAssessment] | None = None,
    ) -> Catalogue:
        """The catalogue with the assessments of (chart, version) and of applications; what has none stays without
        assurance."""
        charts = {
            chart: tuple(_assessed(version, assessments.get((chart, version.version))) for version in versions)
            for chart, versions in self.charts.items()
        }
        known = applications or {}
        judged = {name: _judged(one, known.get(name)) for name, one in self.applications.items()}
        return replace(self, charts=charts, applications=judged)

    def allows(self, candidate: ChartVersion) -> str:
        """Why the release policy forbids to deploy `candidate`; empty when it allows it."""
        if candidate.state not in ASSURANCES[self.assurance]:
            return f"state {candidate.state} is not allowed"
        if self.assurance != "none" and not candidate.assured:
            return f"no valid evidence: {candidate.evidence_problem}"
        return ""

    def evidence_of(self, version: ChartVersion) -> str:
        """What a release of `version` names as its evidence: the digest of the summary, or `none`."""
        return version.evidence if self.assurance != "none" and version.evidence else "none"

    def candidates(self, requirement: ChartRequirement) -> Sequence[ChartVersion]:
        """Every version of the named chart, or that provides what is asked for: newest first, then by chart."""
        if requirement.name:
            return self._by_chart.get(requirement.name, ())
        return self._by_word.get(requirement.provides, ())

    @cached_property
    def _by_chart(self) -> Mapping[str, Sequence[ChartVersion]]:
        return {chart: _newest_first(versions) for chart, versions in self.charts.items()}

    @cached_property
    def _by_word(self) -> Mapping[str, Sequence[ChartVersion]]:
        by_capability: dict[str, list[ChartVersion]] = {}
        for versions in self.charts.values():
            for version in versions:
                for word in version.provides:
                    by_capability.setdefault(word, []).append(version)
        return {word: _newest_first(versions) for word, versions in by_capability.items()}

    def select(
        self,
        requirement: ChartRequirement,
        more: Sequence[GuaranteeRequirement] = (),
        platforms: frozenset[str] = frozenset(),
        pinned: Pin | None = None,
        withheld: Mapping[Pin, str] | None = None,
    ) -> tuple[ChartVersion, tuple[str, ...]]:
        """The highest version that the policy allows and that meets the requirement, and why each candidate was
        selected or not; the `pinned` one as long as it still meets all of that.

        `more`: requirements of a task, asked of charts that state such a guarantee in any version. `platforms`: one of
        them must be the chart's (none: any). `withheld`: versions that are not selected unless pinned, with why.
        RefusalError(GuaranteeNotMet) when only guarantees are missing, else RefusalError(NoVerifiedVersion)."""
        candidates = self.candidates(requirement)
        stated = {guarantee.name for candidate in candidates for guarantee in candidate.guarantees} if more else set()
        required = (*requirement.requirements, *(added for added in more if added.name in stated))
        judged = [(c, *self._judge(c, requirement, required, platforms, pinned, withheld or {})) for c in candidates]
        good = [c for c, obstacle, weak in judged if not (obstacle or weak)]
        held = next((c for c in good if (c.chart, c.version) == pinned), None)
        chosen = held or next(iter(good), None)
        reasons = _bounded(
            f"{c.chart} {c.version} ({c.state}): {obstacle or weak or _comparison(c, chosen, held)}"
            for c, obstacle, weak in judged
        )
        if chosen is None:
            refusal = "GuaranteeNotMet" if any(weak for _, _, weak in judged) else "NoVerifiedVersion"
            detail = "; ".join(reasons) or "the catalogue has no version of it"
            text = (
                f"no version of {requirement}{_more(required, requirement)} with assurance {self.assurance}: {detail}"
            )
            raise RefusalError(refusal, text)
        return chosen, tuple(reasons)

    def _judge(
        self,
        candidate: ChartVersion,
        requirement: ChartRequirement,
        required: Sequence[GuaranteeRequirement],
        platforms: frozenset[str],
        pinned: Pin | None,
        withheld: Mapping[Pin, str],
    ) -> tuple[str, str]:
        """The obstacle to a candidate, and, if there is none, which guarantees it lacks."""
        pin = (candidate.chart, candidate.version)
        obstacle = _outside(candidate, requirement) or self.allows(candidate) or _elsewhere(candidate, platforms)
        if not obstacle and pin != pinned:
            obstacle = withheld.get(pin, "")
        shortfalls = (shortfall(wanted, candidate.guarantees) for wanted in required)
        return obstacle, "" if obstacle else "; ".join(text for text in shortfalls if text)


def _newest_first(versions: Sequence[ChartVersion]) -> Sequence[ChartVersion]:
    return tuple(sorted(sorted(versions, key=lambda c: c.chart), key=lambda c: version_key(c.version), reverse=True))


def _more(required: Sequence[GuaranteeRequirement], requirement: ChartRequirement) -> str:
    return "".join(f", {added} (asked by the task)" for added in required[len(requirement.requirements) :])


def _bounded(reasons: Iterable[str]) -> Sequence[str]:
    listed = list(reasons)
    if len(listed) <= REASONS_MAX:
        return listed
    return [*listed[:REASONS_MAX], f"and {len(listed) - REASONS_MAX} candidates after these"]


def _elsewhere(candidate: ChartVersion, platforms: frozenset[str]) -> str:
    if not platforms or not candidate.platforms or platforms & set(candidate.platforms):
        return ""
    return f"runs on {', '.join(candidate.platforms)}, the nodes are {', '.join(sorted(platforms))}"


def _outside(candidate: ChartVersion, requirement: ChartRequirement) -> str:
    return "" if in_range(candidate.version, requirement.version) else f"not in {requirement.version}"


def _comparison(candidate: ChartVersion, chosen: ChartVersion | None, held: ChartVersion | None) -> str:
    if candidate is held:
        return "kept: the release runs it"
    if candidate is chosen:
        return "taken"
    if chosen is None or held:
        return "possible; the release keeps its version" if held else "possible"
    if candidate.version == chosen.version:
        return f"possible; {chosen.chart} comes first by name"
    return f"older than {chosen.version}" + ("" if chosen.chart == candidate.chart else f" of {chosen.chart}")


def _assessed(version: ChartVersion, assessment: EvidenceAssessment | None) -> ChartVersion:
    if assessment is None:
        return version
    problem = "" if assessment.assured else "; ".join(assessment.problems) or "it does not meet the policy"
    return replace(version, assured=assessment.assured, evidence_problem=problem, findings=assessment.findings)


def _judged(application: Application, assessment: ApplicationAssessment | None) -> Application:
    if assessment is None:
        return application
    problem = "; ".join(assessment.problems)
    return replace(application, evidence=assessment.evidence, assured=assessment.assured, evidence_problem=problem)


def read_catalogue(files: Mapping[str, str], published: bool = True) -> Catalogue:
    """The catalogue in `files` (path -> text); unusable files become problems. Nothing is assured yet.

    `published`: the files are those of the catalogue repository; otherwise sources, whose charts have no status."""
    applications: dict[str, Application] = {}
    charts: dict[str, list[ChartVersion]] = {}
    policy = ReleasePolicy("verified")
    problems: list[str] = []
    for path, parts in _entries(files):
        try:
            if parts[0] == "applications" and len(parts) == 2:
                applications[parts[1]] = read_application(files[path], path)
            elif parts[0] == "charts" and len(parts) == 3:
                charts.setdefault(parts[1], []).append(read_chart_version(files[path], path, published))
            elif path == RELEASE_POLICY:
                policy = read_release_policy(files[path], path)
        except DocumentError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
    versions = {name: tuple(v) for name, v in charts.items()}
    return Catalogue(applications, versions, policy.assurance, tuple(problems), policy.applications)


def _entries(files: Mapping[str, str]) -> Iterable[tuple[str, list[str]]]:
    for path in sorted(files):
        if path.endswith(".yaml"):
            yield path, path.removesuffix(".yaml").split("/")


@dataclass(frozen=True)
class ReleasePolicy:
    """The content of policies/release.yaml. `assurance`: one of ASSURANCES; `initial_for`: whether applications that
    run by themselves wait for a person's approval (PERSON, the default) or are published at once (AUTOMATIC);
    `applications`: one of APPLICATION_ASSURANCES, TRANSITION when the file says nothing."""

    assurance: str
    initial_for: str = PERSON
    applications: str = TRANSITION


def read_release_policy(text: str, path: str) -> ReleasePolicy:
    """The release policy in `text`; DocumentError names every problem."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["assurance"], ["initialFor", "applications"])
    assurance = read_one_of(reader, document.get("assurance"), "assurance", ASSURANCES)
    initial_for, applications = PERSON, TRANSITION
    if "initialFor" in document:
        initial_for = read_one_of(reader, document["initialFor"], "initialFor", (PERSON, AUTOMATIC))
    if "applications" in document:
        applications = read_one_of(reader, document["applications"], "applications", APPLICATION_ASSURANCES)
    reader.finish()
    return ReleasePolicy(assurance, initial_for, applications)
