"""What of a folder is tried before it is submitted: one chart, one application with its charts, or all of them.

charts/apps/delivery-plan              a chart: its folder
registry/applications/delivery.yaml    an application, with the charts of the folder that its services may get
.                                      every chart of charts/apps and every application of registry
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError
from robotkube.registry.catalogue.adapters.source_folders import read_sources
from robotkube.registry.catalogue.core.catalogue import read_catalogue
from robotkube.registry.charts.core.packing import CHART_FILE
from robotkube.registry.evidence.core.verification_policy import (
    PATH,
    PLAIN_SUITES,
    SuiteRule,
    VerificationPolicy,
    read_verification_policy,
)
from robotkube.registry.publication.adapters import submission_folders
from robotkube.registry.publication.ports import ChartSource

CHARTS, REGISTRY = Path("charts", "apps"), Path("registry")
STAND_IN_HOST = "unknown.invalid"
SECONDS_MAX = 60
LEVELS_MAX = 8  # from a chart's folder up to the one that holds `registry`


@dataclass(frozen=True)
class TriedFolder:
    """The names of charts and applications to try, and the folders that hold them."""

    names: tuple[str, ...]
    applications: tuple[str, ...]
    charts: Path
    registry: Path

    def read(self, images: Mapping[str, str]) -> list[ChartSource]:
        """The charts, packed with `images`, and with a stand-in for each that is not among them."""
        sources = []
        for name in self.names:
            _, wanted = submission_folders.image_names(name, self.charts, self.registry)
            known = {image: images.get(image) or stand_in(image) for image in wanted}
            sources.append(submission_folders.read_chart(name, self.charts, self.registry, known))
        return sources

    def policy(self, own: Mapping[str, str]) -> VerificationPolicy:
        """The verification policy of the sources; without one the suites `own` (name -> version)."""
        path = self.registry / PATH
        if path.is_file():
            return read_verification_policy(path.read_text(encoding="utf-8"), str(path))
        rules = [SuiteRule(name, own[name], SECONDS_MAX) for name in PLAIN_SUITES]
        return VerificationPolicy("none", tuple(rules), "")


def stand_in(image: str) -> str:
    """A reference by digest for an image of which none is known."""
    return f"{STAND_IN_HOST}/{image}@sha256:{'0' * 64}"


def stand_ins(chart: ChartSource) -> list[str]:
    """The names of the images for which a chart was packed with a stand-in."""
    prefix = f"{STAND_IN_HOST}/"
    return [image.removeprefix(prefix).partition("@")[0] for image in chart.images if image.startswith(prefix)]


def find_tried(path: Path, charts: Path | None = None, registry: Path | None = None) -> TriedFolder:
    """What `path` names; `charts` and `registry` are the folders where it does not lie in the usual ones."""
    if path.is_file() and path.resolve().parent.name == "applications":
        path = path if len(path.parents) > 2 else path.resolve()
        return _application(path, charts or path.parents[2] / CHARTS, path.parents[1])
    if (path / CHART_FILE).is_file():
        folder = path.resolve()
        return TriedFolder((folder.name,), (), folder.parent, registry or registry_above(folder))
    folders = charts or path / CHARTS, registry or path / REGISTRY
    if all(folder.is_dir() for folder in folders):
        names = submission_folders.all_charts(folders[0])
        return TriedFolder(tuple(names), tuple(submission_folders.all_applications(folders[1])), *folders)
    what = f"neither the folder of a chart ({CHART_FILE}), nor the file of an application in applications/"
    raise InputError(f"{path}: {what}, nor a folder with {CHARTS} and {REGISTRY}; name one of them")


def _application(path: Path, charts: Path, registry: Path) -> TriedFolder:
    """An application with those charts of the folder that its services may get."""
    catalogue = read_catalogue(read_sources(registry).files, published=False)
    application = catalogue.applications.get(path.stem)
    services = application.services if application else ()
    wanted = {version.chart for service in services for version in catalogue.candidates(service.chart)}
    here = submission_folders.all_charts(charts)
    return TriedFolder(tuple(name for name in here if name in wanted), (path.stem,), charts, registry)


def registry_above(folder: Path) -> Path:
    """The catalogue's sources beside one of the folders above; InputError when there are none."""
    for above in list(folder.parents)[:LEVELS_MAX]:
        if (above / REGISTRY / "charts").is_dir():
            return above / REGISTRY
    raise InputError(f"{folder}: no folder above it has {REGISTRY}/charts with its entry; give it with --registry")
