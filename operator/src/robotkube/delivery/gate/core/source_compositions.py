"""Compositions of the applications in a catalogue's sources: what the gate's trial would find before it renders, said
by `registry validate` before anything is submitted."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from robotkube.delivery.gate.core.application_compositions import ApplicationCompositions
from robotkube.registry.catalogue.core.applications import Application
from robotkube.registry.catalogue.core.catalogue import NONE, Catalogue, ChartVersion, read_catalogue
from robotkube.registry.catalogue.core.sources import CatalogueSources, SourceProblem, Tools

ROS = "ros"  # the kind of links that need no bridge
DIGEST = f"sha256:{'0' * 64}"  # of a chart that is not packed yet


@dataclass(frozen=True)
class SourceCompositions:
    """What composing the sources' applications gave: `problems` in their documents; `untried` are names of applications
    for which there was no time."""

    problems: tuple[SourceProblem, ...] = ()
    untried: tuple[str, ...] = ()


def compose_sources(
    sources: CatalogueSources, findings: Collection[SourceProblem], tools: Tools, late: Callable[[], bool]
) -> SourceCompositions:
    """Compose every application but those that rest on something in which validation has `findings`: of them it would
    only say what follows. Ends when it is `late`."""
    catalogue = _as_published(read_catalogue(sources.files, published=False))
    wrong = {finding.file for finding in findings}
    problems: list[SourceProblem] = []
    untried: list[str] = []
    for name, application in sorted(catalogue.applications.items()):
        places = _places(application, catalogue, sources)
        if not places or any(file.startswith(places) for file in wrong):
            continue
        compositions = ApplicationCompositions(name, catalogue, _schemas(sources), tools.render, tools.validate)
        samples = compositions.samples()
        if samples and compositions.composed(samples, late) is None:
            untried.append(name)
        file = f"{sources.root}/applications/{name}.yaml"
        problems += [SourceProblem(file, key, " ".join(text.split())) for key, text in compositions.problems]
    return SourceCompositions(tuple(problems), tuple(untried))


def _as_published(catalogue: Catalogue) -> Catalogue:
    """The catalogue as it would be were all of it verified and published."""
    charts = {chart: tuple(_verified(version) for version in versions) for chart, versions in catalogue.charts.items()}
    return replace(catalogue, charts=charts, assurance=NONE, application_assurance=NONE)


def _verified(version: ChartVersion) -> ChartVersion:
    return replace(version, state="verified", digest=DIGEST)


def _places(application: Application, catalogue: Catalogue, sources: CatalogueSources) -> tuple[str, ...]:
    """The beginnings of the files that the composition of an application rests on; none when a part of it is not there:
    it cannot be read, or that is a finding already."""
    kinds = {link.kind for link in application.links if link.kind != ROS}
    bridges = [a for a in catalogue.applications.values() if kinds.intersection(a.bridges)]
    parts = [application, *bridges]
    candidates = [catalogue.candidates(service.chart) for part in parts for service in part.services]
    if len(bridges) < len(kinds) or not all(candidates):
        return ()
    charts = {version.chart for versions in candidates for version in versions}
    folders = [folder.path for name, folder in sources.folders.items() if name in charts]
    return (
        *(f"{sources.root}/applications/{part.name}.yaml" for part in parts),
        *(f"{sources.root}/charts/{chart}/" for chart in charts),
        *(f"{folder}/" for folder in folders),
    )


def _schemas(sources: CatalogueSources) -> Callable[[str, str], Mapping[str, Any] | None]:
    """The values schemas of the charts beside the registry, with their values as `default`."""

    def schema(chart: str, version: str) -> Mapping[str, Any] | None:
        folder = sources.folders.get(chart)
        if folder is None or folder.version != version or folder.schema is None:
            return None
        return {**folder.schema, "default": folder.values}

    return schema
