"""The chart that is to be installed, from a folder or an archive as `helm package` makes it, and files of values."""

from __future__ import annotations

import os
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from robotkube.delivery.preflight.core.values import merged
from robotkube.errors import DocumentError, InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.yaml_codec import json_problems
from robotkube.registry.charts.adapters.helm import FILES_BYTES_MAX, FILES_MAX, SCHEMA_FILE
from robotkube.registry.charts.core.packing import CHART_FILE

VALUES_FILE = "values.yaml"
NAME = "robotkube"


@dataclass(frozen=True)
class PlatformChart:
    """The files of the chart, what Chart.yaml says of it, its defaults and the schema of its values."""

    files: Mapping[str, bytes]
    metadata: Mapping[str, Any]
    defaults: Mapping[str, Any]
    schema: Mapping[str, Any]


def read_chart(path: Path) -> PlatformChart:
    """The chart at `path`; InputError names path and fix when it is none, or another one than the platform's."""
    files = _archived(path) if path.is_file() else _in_folder(path)
    if CHART_FILE not in files:
        raise InputError(f"{path}: holds no {CHART_FILE}; name the folder or archive of the chart with --chart")
    metadata = _mapping(files[CHART_FILE], f"{path}/{CHART_FILE}")
    if metadata.get("name") != NAME:
        raise InputError(f"{path}: is chart {metadata.get('name')}; name that of the platform, {NAME}, with --chart")
    defaults = _mapping(files.get(VALUES_FILE, b"{}"), f"{path}/{VALUES_FILE}")
    return PlatformChart(files, metadata, defaults, _schema(files, path))


def read_values(paths: Sequence[Path]) -> dict[str, Any]:
    """The values of these files, later ones above earlier ones, as Helm takes them."""
    values: dict[str, Any] = {}
    for path in paths:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; name a file of values with --values") from error
        values = merged(values, _mapping(data, str(path)))
    return values


def _mapping(data: bytes, where: str) -> dict[str, Any]:
    try:
        document = yaml.safe_load(data)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        raise DocumentError(where, [f"{line}not readable as YAML; correct it"]) from error
    if document is None:
        return {}
    if not isinstance(document, dict):
        raise DocumentError(where, ["not a map of keys"])
    problems = json_problems(document, "")
    if problems:
        raise DocumentError(where, problems)
    return document


def _schema(files: Mapping[str, bytes], path: Path) -> Mapping[str, Any]:
    try:
        return dict(read_json(files.get(SCHEMA_FILE, b"{}")))
    except ValueError as error:
        raise InputError(f"{path}/{SCHEMA_FILE}: no JSON: {error}") from error


def _in_folder(path: Path) -> dict[str, bytes]:
    """The files below a folder, those that links lead to among them, as Helm takes them."""
    if not path.is_dir():
        raise InputError(f"{path}: there is no such chart; name its folder or archive with --chart")
    files: dict[str, bytes] = {}
    size = 0
    for place, folders, names in os.walk(path, followlinks=True):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in (one for one in names if not one.startswith(".")):
            file = Path(place) / name
            size += file.stat().st_size
            _bound(path, len(files) + 1, size)
            files[file.relative_to(path).as_posix()] = file.read_bytes()
    return files


def _archived(path: Path) -> dict[str, bytes]:
    """The files of an archive, without the folder that holds them there."""
    files: dict[str, bytes] = {}
    size = 0
    try:
        with tarfile.open(path, "r:gz") as archive:
            for member in archive:
                if member.isfile():
                    size += member.size
                    _bound(path, len(files) + 1, size)
                    opened = archive.extractfile(member)
                    files[member.name.partition("/")[2]] = opened.read() if opened else b""
    except (tarfile.TarError, OSError, EOFError) as error:
        raise InputError(f"{path}: no archive of a chart ({error}); make one with helm package") from error
    return files


def _bound(path: Path, files: int, size: int) -> None:
    if files > FILES_MAX or size > FILES_BYTES_MAX:
        raise InputError(f"{path}: more than {FILES_MAX} files or {FILES_BYTES_MAX} bytes; name the chart's own folder")
