"""The catalogue as values: applications, chart versions, the release policy; reading them, selecting a version.

    applications/<name>.yaml            what can be asked for
    charts/<chart>/<version>.yaml       what exists, in which state, by which digest
    policies/release.yaml               which states may be deployed
    evidence/...                        signed envelopes: not read here; `with_evidence` takes what they prove

A file that breaks its rules makes that one entry unusable and is named in `Catalogue.problems`; the others stay.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from robotkube.domain.catalogue_applications import Application, ChartRequirement, read_application
from robotkube.domain.catalogue_charts import ChartVersion, read_chart_version
from robotkube.domain.catalogue_entries import read_one_of
from robotkube.domain.documents import Reader
from robotkube.domain.errors import DocumentError, RefusalError
from robotkube.domain.guarantees import shortfall
from robotkube.domain.texts import read_mapping
from robotkube.domain.versions import in_range, version_key

__all__ = [
    "ASSURANCES",
    "FOLDERS",
    "Application",
    "Catalogue",
    "ChartRequirement",
    "ChartVersion",
    "read_application",
    "read_assurance",
    "read_catalogue",
    "read_chart_version",
]

FOLDERS = ("applications", "charts", "policies", "evidence")
RELEASE_POLICY = "policies/release.yaml"
VERIFICATION_POLICY = "policies/verification.yaml"
ASSURANCES: Mapping[str, frozenset[str]] = {
    "none": frozenset({"staged", "verified"}),
    "verified": frozenset({"verified"}),
}


class Assessed(Protocol):
    """What somebody found about the evidence of one chart version."""

    @property
    def assured(self) -> bool:
        """Every suite of the policy passed on this digest, signed by a trusted key."""

    @property
    def problems(self) -> Sequence[str]:
        """Why not."""


@dataclass(frozen=True)
class Catalogue:
    """Everything that can be selected, at one commit of the catalogue repository."""

    applications: Mapping[str, Application] = field(default_factory=dict)
    charts: Mapping[str, tuple[ChartVersion, ...]] = field(default_factory=dict)
    assurance: str = "verified"
    problems: tuple[str, ...] = ()

    def bridge(self, kind: str) -> Application:
        """The application whose service bridges links of that kind; RefusalError when there is not exactly one."""
        found = [a for a in self.applications.values() if kind in a.bridges]
        if len(found) != 1:
            names = ", ".join(sorted(a.name for a in found)) or "none does"
            raise RefusalError("CompositionFailed", f"exactly one application must provide link/{kind}; {names}")
        return found[0]

    def version(self, chart: str, version: str) -> ChartVersion | None:
        """One version of a chart; None when there is none."""
        return next((found for found in self.charts.get(chart, ()) if found.version == version), None)

    def with_evidence(self, assessments: Mapping[tuple[str, str], Assessed]) -> Catalogue:
        """The catalogue with what was found about (chart, version); the others stay in doubt."""
        charts = {
            chart: tuple(_assessed(found, assessments.get((chart, found.version))) for found in versions)
            for chart, versions in self.charts.items()
        }
        return replace(self, charts=charts)

    def allows(self, candidate: ChartVersion) -> str:
        """Why the release policy forbids to deploy `candidate`; empty when it allows it."""
        if candidate.state not in ASSURANCES[self.assurance]:
            return f"state {candidate.state} is not allowed"
        if self.assurance != "none" and not candidate.assured:
            return f"no valid evidence: {candidate.doubt}"
        return ""

    def evidence_of(self, version: ChartVersion) -> str:
        """What a release of `version` names as its evidence: the digest of the summary, or `none`."""
        return version.evidence if self.assurance != "none" and version.evidence else "none"

    def candidates(self, requirement: ChartRequirement) -> list[ChartVersion]:
        """Every version of the named chart, or that provides what is asked for: newest first, then by chart."""
        if requirement.name:
            found = list(self.charts.get(requirement.name, ()))
        else:
            found = [c for versions in self.charts.values() for c in versions if requirement.provides in c.provides]
        return sorted(sorted(found, key=lambda c: c.chart), key=lambda c: version_key(c.version), reverse=True)

    def select(self, requirement: ChartRequirement) -> tuple[ChartVersion, tuple[str, ...]]:
        """The highest version that the policy allows and that meets the requirement, and why each candidate was taken
        or not.

        RefusalError(GuaranteeNotMet) when only guarantees are missing, else RefusalError(NoVerifiedVersion)."""
        reasons: list[str] = []
        chosen: ChartVersion | None = None
        refusal = "NoVerifiedVersion"
        for candidate in self.candidates(requirement):
            obstacle, weak = _outside(candidate, requirement) or self.allows(candidate), ""
            if not obstacle:
                weak = _weakness(candidate, requirement)
            if weak:
                refusal = "GuaranteeNotMet"
            verdict = obstacle or weak or _comparison(candidate, chosen)
            reasons.append(f"{candidate.chart} {candidate.version} ({candidate.state}): {verdict}")
            chosen = chosen or (None if obstacle or weak else candidate)
        if chosen is None:
            detail = "; ".join(reasons) or "the catalogue has no version of it"
            raise RefusalError(refusal, f"no version of {requirement} with assurance {self.assurance}: {detail}")
        return chosen, tuple(reasons)


def _outside(candidate: ChartVersion, requirement: ChartRequirement) -> str:
    return "" if in_range(candidate.version, requirement.version) else f"not in {requirement.version}"


def _weakness(candidate: ChartVersion, requirement: ChartRequirement) -> str:
    found = (shortfall(wanted, candidate.guarantees) for wanted in requirement.requirements)
    return "; ".join(text for text in found if text)


def _comparison(candidate: ChartVersion, chosen: ChartVersion | None) -> str:
    if chosen is None:
        return "taken"
    if candidate.version == chosen.version:
        return f"possible; {chosen.chart} comes first by name"
    return f"older than {chosen.version}" + ("" if chosen.chart == candidate.chart else f" of {chosen.chart}")


def _assessed(found: ChartVersion, assessment: Assessed | None) -> ChartVersion:
    if assessment is None:
        return found
    doubt = "" if assessment.assured else "; ".join(assessment.problems) or "it does not meet the policy"
    return replace(found, assured=assessment.assured, doubt=doubt)


def read_catalogue(files: Mapping[str, str], published: bool = True) -> Catalogue:
    """The catalogue in `files` (path -> text); unusable files become problems. Nothing is assured yet.

    `published`: the files are those of the catalogue repository; otherwise sources, whose charts have no status."""
    applications: dict[str, Application] = {}
    charts: dict[str, list[ChartVersion]] = {}
    assurance, problems = "verified", list[str]()
    for path, parts in _entries(files):
        try:
            if parts[0] == "applications" and len(parts) == 2:
                applications[parts[1]] = read_application(files[path], path)
            elif parts[0] == "charts" and len(parts) == 3:
                charts.setdefault(parts[1], []).append(read_chart_version(files[path], path, published))
            elif path == RELEASE_POLICY:
                assurance = read_assurance(files[path], path)
        except DocumentError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
    return Catalogue(applications, {name: tuple(v) for name, v in charts.items()}, assurance, tuple(problems))


def _entries(files: Mapping[str, str]) -> Iterable[tuple[str, list[str]]]:
    for path in sorted(files):
        if path.endswith(".yaml"):
            yield path, path.removesuffix(".yaml").split("/")


def read_assurance(text: str, path: str) -> str:
    """The release policy: `assurance: none | verified`."""
    reader = Reader(path)
    document = reader.mapping(read_mapping(text, path), "", ["assurance"])
    assurance = read_one_of(reader, document.get("assurance"), "assurance", ASSURANCES)
    reader.finish()
    return assurance
