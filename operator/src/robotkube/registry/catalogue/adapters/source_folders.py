"""The sources of a catalogue in a folder, and the charts next to it, read within bounds; unreadable files become
findings."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import NAME, VERSION
from robotkube.foundation.documents.core.yaml_codec import TEXT_BYTES_MAX, json_problems, read_mapping
from robotkube.registry.catalogue.core.sources import CatalogueSources, ChartFolder, SourceProblem

FILES_MAX = 10_000
CHART_FILE, VALUES_FILE, SCHEMA_FILE = "Chart.yaml", "values.yaml", "values.schema.json"
IMAGES_ANNOTATION = "robotkube.io/images"
UNREAD = ("schemas", "images.yaml")  # folders and files of the registry that are no sources of the catalogue

T = TypeVar("T")


def read_sources(registry: Path, charts: Path | None = None) -> CatalogueSources:
    """Everything below `registry`, and the charts in the folders of `charts` when that folder is there.

    InputError when `registry` is no folder or holds more than FILES_MAX files."""
    if not registry.is_dir():
        raise InputError(f"{registry}: no folder; name the one that holds applications/, charts/ and policies/")
    findings: list[SourceProblem] = []
    files = {}
    for path, name in _walk(registry):
        try:
            files[name] = _text(path)
        except DocumentError as error:
            findings += [SourceProblem(f"{registry}/{name}", "file", problem) for problem in error.problems]
    folders: dict[str, ChartFolder] = {}
    for folder in sorted(charts.iterdir()) if charts and charts.is_dir() else ():
        if (folder / CHART_FILE).is_file():
            _add_chart(folder, folders, findings)
    return CatalogueSources(str(registry), files, folders, tuple(findings))


def _walk(registry: Path) -> Iterator[tuple[Path, str]]:
    count = 0
    for place, folders, names in os.walk(registry):
        inside = Path(place).relative_to(registry)
        folders[:] = sorted(f for f in folders if not f.startswith(".") and (inside / f).as_posix() not in UNREAD)
        for name in sorted(n for n in names if not n.startswith(".") and (inside / n).as_posix() not in UNREAD):
            count += 1
            if count > FILES_MAX:
                raise InputError(f"{registry}: more than {FILES_MAX} files; name the folder of the catalogue's sources")
            yield Path(place) / name, (inside / name).as_posix()


def _text(path: Path) -> str:
    """A text file within the bound of documents."""
    try:
        if path.is_symlink() or not path.is_file():
            raise DocumentError(str(path), ["no ordinary file; put a copy there"])
        with path.open("rb") as stream:
            data = stream.read(TEXT_BYTES_MAX + 1)
        if len(data) > TEXT_BYTES_MAX:
            raise DocumentError(str(path), [f"longer than {TEXT_BYTES_MAX} bytes; split it"])
        return data.decode()
    except UnicodeDecodeError as error:
        problem = f"byte {error.start} is not UTF-8; save the file as UTF-8"
        raise DocumentError(str(path), [problem]) from error
    except OSError as error:
        raise DocumentError(str(path), [f"{error.strerror}; make it readable"]) from error


def _add_chart(folder: Path, folders: dict[str, ChartFolder], findings: list[SourceProblem]) -> None:
    """Add the chart in a folder; what cannot be read in any of its files is a finding, and it is left out then."""
    problems: list[SourceProblem] = []
    chart = _part(lambda: _metadata(folder), problems)
    values = _part(lambda: _values(folder / VALUES_FILE), problems)
    schema = _part(lambda: _schema(folder / SCHEMA_FILE), problems)
    findings += problems
    if chart is None or problems:
        return
    if chart.name in folders:
        text = f"{chart.name} is also the name of {folders[chart.name].path}; rename one of the charts"
        findings.append(SourceProblem(f"{folder}/{CHART_FILE}", "name", text))
    folders[chart.name] = replace(chart, values=values or {}, schema=schema)


def _part(read: Callable[[], T], problems: list[SourceProblem]) -> T | None:
    """One part of a chart; None when it cannot be read, which is added to the problems."""
    try:
        return read()
    except DocumentError as error:
        texts = [problem if ";" in problem else f"{problem}; correct it" for problem in error.problems]
        problems += [SourceProblem(error.where, "document", text) for text in texts]
        return None


def _metadata(folder: Path) -> ChartFolder | None:
    """The chart as Chart.yaml describes it; None for a library."""
    where = f"{folder}/{CHART_FILE}"
    metadata = read_mapping(_text(folder / CHART_FILE), where)
    if metadata.get("type") == "library":
        return None
    name, version = str(metadata.get("name", "")), str(metadata.get("version", ""))
    wrong = [
        f"{key} {f'{value!r:.80} is malformed' if value else 'is missing'}; write {fix}"
        for key, value, pattern, fix in (
            ("name", name, NAME, "the name of the folder"),
            ("version", version, VERSION, "one such as 0.1.0"),
        )
        if not pattern.fullmatch(value)
    ]
    if wrong:
        raise DocumentError(where, wrong)
    annotations = metadata.get("annotations")
    images = annotations.get(IMAGES_ANNOTATION) if isinstance(annotations, Mapping) else None
    return ChartFolder(str(folder), name, version, tuple(str(images).split()) if images is not None else None)


def _values(path: Path) -> Mapping[str, Any]:
    text = _text(path) if path.is_file() else ""
    written = any(line.strip() and not line.lstrip().startswith("#") for line in text.splitlines())
    return read_mapping(text, str(path)) if written else {}


def _schema(path: Path) -> Mapping[str, Any] | None:
    if not path.is_file():
        return None
    try:
        schema = read_json(_text(path))
    except ValueError as error:
        raise DocumentError(str(path), [f"not readable as JSON: {error}; correct it"]) from error
    if not isinstance(schema, dict) or json_problems(schema, ""):
        raise DocumentError(str(path), ["must hold one JSON Schema, an object; correct it"])
    return schema
