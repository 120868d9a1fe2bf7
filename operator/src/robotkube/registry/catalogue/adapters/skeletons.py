"""Skeletons: the chart and the catalogue entries a new application starts from, files of this package with its name.

chart/...            -> <charts>/<name>/...
application.yaml     -> <registry>/applications/<name>.yaml
chart-version.yaml   -> <registry>/charts/<name>/0.1.0.yaml

Besides a link to the library chart, <charts>/<name>/charts/robotkube-app, so that helm accepts the folder as it is.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from robotkube.errors import InputError, RefusalError

SKELETON = "skeletons/application"
FIRST_VERSION = "0.1.0"
LIBRARY = "robotkube-app"


def new_application(name: str, provides: str, charts: Path, registry: Path, dry_run: bool = False) -> Sequence[Path]:
    """Write the files of application `name`, whose chart gives the capability `provides`; returns their paths.

    Everything or nothing is written. RefusalError when a file is there already, InputError when the folders are not
    those of charts and catalogue sources.
    """
    for folder in (charts / LIBRARY, registry / "applications", registry / "charts"):
        if not folder.is_dir():
            raise InputError(f"{folder}: missing; give the folders with --charts and --registry")
    places = {"chart": charts / name, "chart-version.yaml": registry / "charts" / name}
    application = registry / "applications" / f"{name}.yaml"
    existing = [str(place) for place in (*places.values(), application) if place.exists()]
    if existing:
        raise RefusalError("Exists", f"{', '.join(existing)}: there already; choose another name")
    files = {
        _target(path, name, charts, registry): _filled(text, name, provides) for path, text in _read_skeleton().items()
    }
    link = charts / name / "charts" / LIBRARY
    if not dry_run:
        _write_all(files, link, (*places.values(), application))
    return sorted([*files, link])


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


def _target(path: str, name: str, charts: Path, registry: Path) -> Path:
    if path == "application.yaml":
        return registry / "applications" / f"{name}.yaml"
    if path == "chart-version.yaml":
        return registry / "charts" / name / f"{FIRST_VERSION}.yaml"
    return charts / name / path.removeprefix("chart/")


def _filled(text: str, name: str, provides: str) -> str:
    words = {"__NAME__": name, "__ROS__": name.replace("-", "_"), "__PROVIDES__": provides}
    for mark, word in words.items():
        text = text.replace(mark, word)
    return text


def _write_all(files: Mapping[Path, str], link: Path, made: Sequence[Path]) -> None:
    try:
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        link.parent.mkdir()
        link.symlink_to(Path("..", "..", LIBRARY), target_is_directory=True)
    except OSError as error:
        for place in made:
            shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
        raise InputError(f"{error.filename}: {error.strerror}; nothing was kept") from error
