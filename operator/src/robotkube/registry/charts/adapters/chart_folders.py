"""Charts in folders: read, complete and pack them.

Two things are added to a chart's files: the library charts that Chart.yaml names with `repository: file://...` (as
`charts/<name>/`, so the archive needs no other source), and `images.yaml`, which says by digest which image each part
runs.
"""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from robotkube.errors import DocumentError
from robotkube.registry.charts.core.packing import CHART_FILE, IMAGES_FILE, PackedChart, pack_chart

IGNORE_FILE = ".helmignore"
LOCAL = "file://"
IMAGES_ANNOTATION = "robotkube.io/images"  # in Chart.yaml: names of the images it runs, separated by spaces


def pack(
    folder: Path, images: Mapping[str, str], spec: Mapping[str, Any] | None = None, hidden: bool = False
) -> PackedChart:
    """Pack the chart in `folder`; `images` maps image names to references (`repository@sha256:...`), empty to leave
    images.yaml out; `spec` is that of its catalogue entry, without one the chart cannot be published. `hidden`: whether
    it may have hidden files, which Argo CD would read in its own way; only a chart that people install may.

    Raises DocumentError, naming the file, for other hidden files, links, an unreadable Chart.yaml and missing library
    charts.
    """
    metadata = _metadata(folder)
    files = _own_files(folder, _libraries(folder, metadata).keys(), hidden)
    for name, library in _libraries(folder, metadata).items():
        files |= {f"charts/{name}/{path}": data for path, data in _library_files(folder, name, library).items()}
    if images:
        if IMAGES_FILE in files:
            raise DocumentError(
                str(folder / IMAGES_FILE), ["packing adds this file; remove it from the chart's folder"]
            )
        used = _used_images(folder, metadata, images)
        files[IMAGES_FILE] = "".join(f"{name}: {images[name]}\n" for name in used).encode()
    return pack_chart(str(folder), metadata, files, spec)


def _used_images(folder: Path, metadata: Mapping[str, Any], images: Mapping[str, str]) -> list[str]:
    """The images a chart says it uses, else all: a chart's digest should not change with an image it never runs."""
    text = (metadata.get("annotations") or {}).get(IMAGES_ANNOTATION)
    if text is None:
        return sorted(images)
    unknown = [name for name in text.split() if name not in images]
    if unknown:
        problem = (
            f"annotations: {IMAGES_ANNOTATION}: no image {', '.join(unknown)}; there are {', '.join(sorted(images))}"
        )
        raise DocumentError(str(folder / CHART_FILE), [problem])
    return sorted(set(text.split()))


def _metadata(folder: Path) -> dict[str, Any]:
    path = folder / CHART_FILE
    try:
        document = yaml.safe_load(path.read_bytes())
    except FileNotFoundError as error:
        raise DocumentError(str(path), ["missing; name the folder of a chart"]) from error
    except yaml.YAMLError as error:
        raise DocumentError(str(path), [f"no YAML: {error}"]) from error
    if not isinstance(document, dict):
        raise DocumentError(str(path), ["not a map of keys; write at least apiVersion, name and version"])
    return document


def _libraries(folder: Path, metadata: Mapping[str, Any]) -> dict[str, Path]:
    """Name -> folder of the dependencies in this repository; any other dependency is refused, packing fetches
    nothing."""
    libraries = {}
    for dependency in metadata.get("dependencies") or ():
        name = dependency.get("name")
        repository = str(dependency.get("repository", ""))
        if not repository.startswith(LOCAL):
            fix = "name a chart of this repository with file://../<folder>"
            raise DocumentError(
                str(folder / CHART_FILE), [f"dependencies: {name}: repository {repository!r} is not local; {fix}"]
            )
        libraries[name] = (folder / repository.removeprefix(LOCAL)).resolve()
    return libraries


def _library_files(folder: Path, name: str, library: Path) -> dict[str, bytes]:
    described = _metadata(library)
    if described.get("name") != name:
        problem = f"dependencies: {name}: the chart in {library} is named {described.get('name')!r}; use that name"
        raise DocumentError(str(folder / CHART_FILE), [problem])
    if _libraries(library, described):
        raise DocumentError(
            str(library / CHART_FILE), ["dependencies: a library chart may have none; name them in the chart itself"]
        )
    return _own_files(library, ())


def _own_files(folder: Path, libraries: Any, hidden: bool = False) -> dict[str, bytes]:
    """The files of the folder itself; `charts/<library>` is left out, because the library's own folder is what
    counts."""
    problems = []
    files = {}
    ignored = _ignored_patterns(folder)
    left_out = {f"charts/{name}" for name in libraries}
    for path, relative in _walk(folder, left_out):
        if relative == IGNORE_FILE or _is_ignored(relative, ignored):
            continue
        if path.is_symlink():
            problems.append(
                f"{relative}: a link; an archive holds files, put a copy there or name a dependency with file://"
            )
        elif not hidden and any(part.startswith(".") for part in relative.split("/")):
            problems.append(f"{relative}: a hidden file; remove it or list it in {IGNORE_FILE}")
        else:
            files[relative] = path.read_bytes()
    if problems:
        raise DocumentError(str(folder), problems)
    return files


def _walk(folder: Path, left_out: set[str]) -> Iterator[tuple[Path, str]]:
    """Files and links (also links to folders) below the folder, with their paths inside it."""
    for place, folders, names in os.walk(folder):
        base = Path(place)
        for name in sorted(folders):
            relative = (base / name).relative_to(folder).as_posix()
            if relative in left_out:
                folders.remove(name)
            elif (base / name).is_symlink():
                yield base / name, relative
        for name in sorted(names):
            yield base / name, (base / name).relative_to(folder).as_posix()


def _ignored_patterns(folder: Path) -> list[str]:
    path = folder / IGNORE_FILE
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    patterns = [line.strip() for line in lines if line.strip() and not line.startswith("#")]
    negated = [pattern for pattern in patterns if pattern.startswith("!")]
    if negated:
        raise DocumentError(
            str(path), [f"{pattern}: exceptions are not supported; list what to leave out" for pattern in negated]
        )
    return [pattern.rstrip("/") for pattern in patterns]


def _is_ignored(relative: str, patterns: list[str]) -> bool:
    parts = relative.split("/")
    candidates = [*parts, *("/".join(parts[: n + 1]) for n in range(len(parts)))]
    return any(fnmatch.fnmatchcase(candidate, pattern.lstrip("/")) for pattern in patterns for candidate in candidates)
