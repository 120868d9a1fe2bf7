"""Charts as suites get them: packed, and rendered by the real helm as the suite-runner confines it."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robotkube.foundation.documents.core.yaml_codec import read_mapping
from robotkube.registry.charts.adapters.chart_folders import pack
from robotkube.registry.charts.adapters.helm import HelmProgram
from robotkube.registry.charts.core.packing import IMAGES_FILE
from robotkube.registry.evidence.core.statements import Artefact
from robotkube.registry.suites.ports.suites import Subject
from tests.stages.programs import program
from tests.stages.registry import chart_images

IMAGES = chart_images.all_as("forge.robotkube.svc.cluster.local:3000/robotkube/image@sha256:" + "5" * 64)
NAMESPACE = "suite"


def subject_of(chart: Path, entry_file: Path, work: Path, images: Mapping[str, str] = IMAGES) -> Subject:
    """The chart of a folder with its entry; `work` is a folder for helm."""
    entry = read_mapping(entry_file.read_text(encoding="utf-8"), str(entry_file))
    packed = pack(chart, images, entry["spec"])
    with tarfile.open(fileobj=io.BytesIO(packed.archive)) as tar:
        files = {member.name.partition("/")[2]: _content(tar, member) for member in tar.getmembers()}
    helm = HelmProgram(program("helm"), work)

    def render(values: Mapping[str, Any], release: str) -> list[dict[str, Any]]:
        return helm.render(files, values, release, NAMESPACE)

    artefact = Artefact(packed.name, packed.version, packed.digest, "linux/amd64")
    used = read_mapping(files[IMAGES_FILE].decode(), IMAGES_FILE)
    return Subject(artefact, entry, files, packed.archive, used, render)


def _content(tar: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = tar.extractfile(member)
    assert file is not None, member.name
    return file.read()
