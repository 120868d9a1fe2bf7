"""Charts as suites get them: packed, unpacked, and rendered by the real helm."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from robotkube.adapters.chart_folders import pack
from robotkube.domain.errors import InputError
from robotkube.domain.evidence import Artefact
from robotkube.domain.texts import read_mapping
from robotkube.ports.suites import Subject

IMAGES = {"ros": "forge.robotkube.svc.cluster.local:3000/robotkube/ros@sha256:" + "5" * 64}


def subject_of(helm: Any, chart: Path, entry_file: Path, folder: Path) -> Subject:
    """The chart of a folder with its entry; `helm` is the fixture, `folder` a place for the unpacked chart."""
    entry = read_mapping(entry_file.read_text(encoding="utf-8"), str(entry_file))
    packed = pack(chart, IMAGES, entry["spec"])
    with tarfile.open(fileobj=io.BytesIO(packed.archive)) as tar:
        tar.extractall(folder, filter="data")
        files = {m.name.partition("/")[2]: content(tar, m) for m in tar.getmembers()}

    def render(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        done = helm.run("template", release, str(folder / packed.name), "-f", str(helm.values(values)))
        if done.returncode:
            raise InputError(done.stderr)
        return [one for one in yaml.safe_load_all(done.stdout) if one]

    artefact = Artefact(packed.name, packed.version, packed.digest, "linux/amd64")
    images = yaml.safe_load(files["images.yaml"])
    return Subject(artefact, entry, files, packed.archive, images, render)


def content(tar: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    """A file of the archive."""
    file = tar.extractfile(member)
    assert file is not None, member.name
    return file.read()
