"""Skeletons: the charts and the catalogue entries a new application starts from, files of this package with its names.

chart/...            -> <charts>/<chart>/...           (chart/helmignore -> .helmignore, chart/tests/test_node.py
                                                        -> tests/test_<chart>.py)
application.yaml     -> <registry>/applications/<name>.yaml
chart-version.yaml   -> <registry>/charts/<chart>/0.1.0.yaml

Besides a link to the library chart, <charts>/<chart>/charts/robotkube-app, so that helm accepts the folder as it is.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from robotkube.errors import InputError, RefusalError
from robotkube.registry.catalogue.core.links.chains import chain_document, chart_name, ros_word

SKELETON = "skeletons/application"
FIRST_VERSION = "0.1.0"
LIBRARY = "robotkube-app"
APPLICATION, ENTRY = "application.yaml", "chart-version.yaml"


@dataclass(frozen=True)
class _Folders:
    """The folders of charts and of the catalogue's sources."""

    charts: Path
    registry: Path

    def check(self) -> None:
        """InputError when they are not such folders."""
        for folder in (self.charts / LIBRARY, self.registry / "applications", self.registry / "charts"):
            if not folder.is_dir():
                raise InputError(f"{folder}: missing; give the folders with --charts and --registry")

    def application(self, name: str) -> Path:
        """The document of an application."""
        return self.registry / "applications" / f"{name}.yaml"

    def of_chart(self, chart: str) -> tuple[Path, Path]:
        """The folders that belong to a chart: itself and its entries."""
        return self.charts / chart, self.registry / "charts" / chart

    def link(self, chart: str) -> Path:
        """The address at which a chart looks for the library chart."""
        return self.charts / chart / "charts" / LIBRARY

    def target(self, path: str, chart: str) -> Path:
        """The path to which a file of the skeleton goes for a chart."""
        if path == ENTRY:
            return self.registry / "charts" / chart / f"{FIRST_VERSION}.yaml"
        inside = path.removeprefix("chart/")
        inside = {"helmignore": ".helmignore", "tests/test_node.py": f"tests/test_{ros_word(chart)}.py"}.get(
            inside, inside
        )
        return self.charts / chart / inside


def new_application(name: str, provides: str, charts: Path, registry: Path, dry_run: bool = False) -> Sequence[Path]:
    """Write the files of application `name` and its one chart of that name, both with the capability `provides`;
    returns their paths.

    Everything or nothing is written. RefusalError when a file is there already, InputError when the folders are not
    those of charts and catalogue sources.
    """
    application = _filled(_read_skeleton()[APPLICATION], name, provides)
    return _new(name, application, {name: provides}, _Folders(charts, registry), dry_run)


def new_chain(
    name: str, services: Sequence[str], provides: str, charts: Path, registry: Path, dry_run: bool = False
) -> Sequence[Path]:
    """Write the files of application `name` whose services hand texts on, one after the other, with a chart for each
    (`<name>-<service>`, capability `<name>/<service>`); as `new_application` otherwise. The names are right."""
    application = chain_document(name, services, provides)
    capabilities = {chart_name(name, service): f"{name}/{service}" for service in services}
    return _new(name, application, capabilities, _Folders(charts, registry), dry_run)


def _new(
    name: str, application: str, capabilities: Mapping[str, str], folders: _Folders, dry_run: bool
) -> Sequence[Path]:
    """`capabilities`: chart -> what it provides."""
    folders.check()
    made = [folders.application(name), *(place for chart in capabilities for place in folders.of_chart(chart))]
    existing = [str(place) for place in made if place.exists() or place.is_symlink()]
    if existing:
        raise RefusalError("Exists", f"{', '.join(existing)}: there already; choose another name")
    files = {folders.application(name): application}
    skeleton = {path: text for path, text in _read_skeleton().items() if path != APPLICATION}
    for chart, provides in capabilities.items():
        files |= {folders.target(path, chart): _filled(text, chart, provides) for path, text in skeleton.items()}
    links = [folders.link(chart) for chart in capabilities]
    if not dry_run:
        _write_all(files, links, made)
    return sorted([*files, *links])


def _read_skeleton() -> dict[str, str]:
    texts: dict[str, str] = {}
    _collect(resources.files("robotkube.registry.catalogue").joinpath(SKELETON), "", texts)
    return texts


def _collect(folder: Traversable, prefix: str, texts: dict[str, str]) -> None:
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            _collect(entry, f"{prefix}{entry.name}/", texts)
        elif entry.is_file():
            texts[prefix + entry.name] = entry.read_text(encoding="utf-8")


def _filled(text: str, name: str, provides: str) -> str:
    words = {"__NAME__": name, "__ROS__": ros_word(name), "__PROVIDES__": provides}
    for mark, word in words.items():
        text = text.replace(mark, word)
    return text


def _write_all(files: Mapping[Path, str], links: Sequence[Path], made: Sequence[Path]) -> None:
    """Write files and links, or nothing of `made`, which are all files and folders that these begin."""
    try:
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        for link in links:
            link.parent.mkdir()
            link.symlink_to(Path("..", "..", LIBRARY), target_is_directory=True)
    except BaseException as error:  # an interrupt, too, leaves nothing half made
        for place in made:
            shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(f"{error.filename}: {error.strerror}; nothing was kept") from error
        raise
