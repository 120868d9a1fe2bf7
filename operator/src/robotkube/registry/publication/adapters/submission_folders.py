"""The parts of a submission, read from folders: charts packed with their images, entries, applications, evidence
that was kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.errors import DocumentError, InputError, did_you_mean
from robotkube.foundation.documents.adapters.jinja2_templates import Jinja2Templates
from robotkube.foundation.documents.adapters.json_schema import check_schema, validate, violations
from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.catalogue.core.catalogue import read_application, read_chart_version
from robotkube.registry.catalogue.core.chart_versions import ChartVersion
from robotkube.registry.catalogue.core.sources import Tools
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.core.packing import CHART_FILE, IMAGES_FILE
from robotkube.registry.publication.ports import ChartSource, SubmittedSources

LIBRARY = "library"
KEPT_FILES_MAX = 10_000


def read_images(path: Path) -> dict[str, str]:
    """Name -> reference (`repository@sha256:...`) in a YAML file."""
    images = read_mapping(_text(path), str(path))
    problems = [
        f"{name}: {reference!r} must be a reference by digest (repository@sha256:...)"
        for name, reference in images.items()
        if not isinstance(reference, str) or "@sha256:" not in reference
    ]
    if problems:
        raise DocumentError(str(path), problems)
    return images


def known_images(given: Path | None, registry: Path) -> dict[str, str]:
    """What the file `given` names, or without one images.yaml of the catalogue's sources, where `robotkube image push`
    writes references; nothing when it is not there."""
    own = registry / IMAGES_FILE
    return read_images(given or own) if given or own.is_file() else {}


def write_image(registry: Path, name: str, reference: str) -> Path:
    """Write the reference of image `name` into images.yaml of the catalogue's sources, whose other lines stay."""
    path = registry / IMAGES_FILE
    if path.is_file() and read_images(path).get(name) == reference:
        return path
    lines = _text(path).splitlines() if path.is_file() else []
    kept = [line for line in lines if line.partition(":")[0].strip("'\" ") != name]
    text = "".join(f"{line}\n" for line in [*kept, f"{name}: {reference}"])
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    if read_images(part).get(name) != reference:
        part.unlink()
        raise InputError(f"{path}: cannot be extended line by line; write into it: {name}: {reference}")
    part.replace(path)
    return path


def validation_tools() -> Tools:
    """The libraries that validation needs."""
    templates = Jinja2Templates()
    return Tools(templates.render, templates.references, check_schema, validate, violations)


def all_charts(charts: Path) -> list[str]:
    """Names of the charts in a folder that are not libraries."""
    folders = sorted(path.parent for path in charts.glob(f"*/{CHART_FILE}"))
    if not folders:
        raise InputError(f"{charts}: holds no chart; give the folder with --charts")
    return [folder.name for folder in folders if _chart(folder).get("type", "application") != LIBRARY]


def all_applications(registry: Path) -> list[str]:
    """Names of the applications of the sources."""
    return sorted(path.stem for path in (registry / "applications").glob("*.yaml"))


def read_sources(
    names: Sequence[str],
    applications: Sequence[str],
    charts: Path,
    registry: Path,
    images: Mapping[str, str],
    kept: Path | None = None,
) -> SubmittedSources:
    """The named charts, packed with their images, and the named applications; errors name file and fix."""
    return SubmittedSources(
        tuple(read_chart(name, charts, registry, images) for name in dict.fromkeys(names)),
        {f"applications/{name}.yaml": _application(name, registry) for name in dict.fromkeys(applications)},
        read_kept(kept) if kept else {},
    )


def read_chart(name: str, charts: Path, registry: Path, images: Mapping[str, str]) -> ChartSource:
    """The chart in `charts/<name>` and the entry of its version."""
    path, text, entry = _entry(name, charts, registry)
    unknown = [image for image in entry.images if image not in images]
    if unknown:
        known = ", ".join(sorted(images)) or "none"
        fix = "push it (robotkube image push), or give its reference in the file of --images"
        raise InputError(f"{path}: spec.images: no reference of {', '.join(unknown)} (known: {known}); {fix}")
    document: dict[str, Any] = read_mapping(text, str(path))
    used = {image: images[image] for image in entry.images}
    return ChartSource(document, pack(charts / name, used, document["spec"]), tuple(sorted(used.values())))


def image_names(name: str, charts: Path, registry: Path) -> tuple[Path, Sequence[str]]:
    """The entry of the version of the chart in `charts/<name>`, and the names of the images that it says it runs."""
    path, _, entry = _entry(name, charts, registry)
    return path, entry.images


def _entry(name: str, charts: Path, registry: Path) -> tuple[Path, str, ChartVersion]:
    """The entry of the chart's version: its file, its text, and what it says."""
    folder = charts / name
    version = str(_chart(folder).get("version", ""))
    path = registry / "charts" / name / f"{version}.yaml"
    if not path.is_file():
        raise InputError(f"{path}: missing; write the entry of {folder / CHART_FILE}'s version {version!r}")
    text = _text(path)
    try:
        return path, text, read_chart_version(text, f"charts/{name}/{version}.yaml", published=False)
    except DocumentError as error:
        raise DocumentError(str(path), error.problems) from error


def _application(name: str, registry: Path) -> str:
    path = registry / "applications" / f"{name}.yaml"
    if not path.is_file():
        instead = did_you_mean(name, all_applications(registry))
        raise InputError(f"{path}: missing; {instead}Name an application of the folder, or give it with --registry")
    text = _text(path)
    try:
        read_application(text, f"applications/{name}.yaml")
    except DocumentError as error:
        raise DocumentError(str(path), error.problems) from error
    return text


def read_kept(folder: Path) -> dict[str, str]:
    """Evidence kept below `folder`: path in the catalogue -> text; nothing when the folder is not there."""
    files = sorted((folder / "evidence").glob("*/*/*.json"))[:KEPT_FILES_MAX]
    return {path.relative_to(folder).as_posix(): _text(path) for path in files}


def write_kept(folder: Path, evidence: Mapping[str, str]) -> None:
    """Keep evidence below `folder` for the next publication of the same digests."""
    for name, text in evidence.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)


def _chart(folder: Path) -> Mapping[str, Any]:
    path = folder / CHART_FILE
    if not path.is_file():
        instead = did_you_mean(folder.name, (other.parent.name for other in folder.parent.glob(f"*/{CHART_FILE}")))
        raise InputError(f"{path}: missing; {instead}Name a chart of the folder, or give the folder with --charts")
    return read_mapping(_text(path), str(path))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
