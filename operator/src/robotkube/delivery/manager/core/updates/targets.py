"""Targets of updates: the newest version of a chart that somebody can use."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

from robotkube.registry.catalogue.core.applications import ChartRequirement
from robotkube.registry.catalogue.core.catalogue import Catalogue
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.guarantees import shortfall
from robotkube.registry.catalogue.core.versions import in_range, version_key


class Targets:
    """The newest version of each chart in one catalogue, searched once."""

    def __init__(self, catalogue: Catalogue) -> None:
        self.catalogue = catalogue
        self._known: dict[tuple[str, tuple[str, ...], frozenset[str]], ChartVersion | None] = {}
        self._bridges = [a for a in catalogue.applications.values() if a.bridges]

    def newest(self, chart: str, applications: tuple[str, ...], barred: frozenset[str]) -> ChartVersion | None:
        """The newest version that the release policy allows, that is not `barred` (digests), and that a service of the
        applications (empty: of any) can use."""
        question = chart, applications, barred
        if question not in self._known:
            self._known[question] = self._find(*question)
        return self._known[question]

    @cached_property
    def highest(self) -> Mapping[str, str]:
        """The highest version of each chart, whoever may use it."""
        charts = self.catalogue.charts.items()
        return {chart: max((v.version for v in versions), key=version_key) for chart, versions in charts if versions}

    def _find(self, chart: str, applications: tuple[str, ...], barred: frozenset[str]) -> ChartVersion | None:
        known = self.catalogue.applications
        chosen = [known[name] for name in applications if name in known]
        offering = [*chosen, *self._bridges] if chosen else list(known.values())
        wanted = {service.chart for application in offering for service in application.services}
        versions = self.catalogue.charts.get(chart, ())
        for version in sorted(versions, key=lambda version: version_key(version.version), reverse=True):
            suits = any(_suits(version, requirement) for requirement in wanted)
            if suits and version.digest not in barred and not self.catalogue.allows(version):
                return version
        return None


def _suits(version: ChartVersion, requirement: ChartRequirement) -> bool:
    named = requirement.name == version.chart or (not requirement.name and requirement.provides in version.provides)
    weak = any(shortfall(guarantee, version.guarantees) for guarantee in requirement.requirements)
    return named and not weak and in_range(version.version, requirement.version)
