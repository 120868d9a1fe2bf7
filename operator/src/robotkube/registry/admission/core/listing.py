"""The list that follows from a catalogue: of each verified version that is not withdrawn its chart and its images, when
the gate's signature covers them.

The signature is that of the version's summary, over its digest and over the entry with its images. Under which policy
it was made does not matter here (`lasting_problems`): manager and gate ask for today's policy before anything new is
deployed, while what runs already must be able to start again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from robotkube.registry.admission.core.allowed import Allowed, digests_of
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.evidence.core.statements import Artefact, VerifiedStatement, lasting_problems

WITHDRAWN, VERIFIED = "withdrawn", "verified"

Statements = Mapping[str, VerifiedStatement | str]
"""Digest of a summary's envelope -> its statement, or why it is not believed."""


@dataclass(frozen=True)
class AllowedVersions:
    """Charts and images that may run, as `Allowed` has them, and why versions that call themselves verified are not
    among them (a sentence each). `commit`: of main, which this is the list of; empty where nobody knows."""

    charts: tuple[str, ...] = ()
    verified: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    commit: str = ""

    def with_platform(self, digests: tuple[str, ...]) -> Allowed:
        """The whole list, with the digests of the platform's images."""
        return Allowed(self.verified, digests, self.charts)


def artefact_of(version: ChartVersion) -> Artefact:
    """The version as its evidence names it: suites run on one platform."""
    return Artefact(version.chart, version.version, version.digest, next(iter(version.platforms), ""))


def listing(
    current: Mapping[tuple[str, str], ChartVersion | None],
    earlier: Iterable[ChartVersion],
    statements: Statements,
) -> AllowedVersions:
    """The list of a catalogue.

    `current`: chart and version -> its entry on main, None when it cannot be read. `earlier`: entries of the same
    versions with other digests, which main had before: a local build may replace a version, and what runs it goes
    on."""
    replaced = [version for version in earlier if _stands(current, version)]
    charts: set[str] = set()
    images: set[str] = set()
    problems = []
    for version in (*filter(None, current.values()), *replaced):
        if version.state != VERIFIED:
            continue
        statement = statements.get(version.evidence)
        lasting = lasting_problems(artefact_of(version), version.evidence, version.entry, statement)
        if lasting:
            problems.append(f"{version.reference} is not listed: {'; '.join(lasting)}")
        else:
            charts.add(f"{version.chart}@{version.digest}")
            images.update(digests_of(version.image_references))
    return AllowedVersions(tuple(sorted(charts)), tuple(sorted(images)), tuple(dict.fromkeys(problems)))


def _stands(current: Mapping[tuple[str, str], ChartVersion | None], version: ChartVersion) -> bool:
    """Return whether main still has the version, and has not withdrawn it."""
    key = (version.chart, version.version)
    now = current.get(key)
    return key in current and (now is None or now.state != WITHDRAWN)
