"""The platform in one file: every image with its bill, every chart with its evidence, Argo CD's objects, and the
platform's chart with all of these by digest. `python -m ci.bundle` is the command.

    build/bundle/robotkube-<version>.tar          an OCI image layout
    build/bundle/robotkube-<version>.tar.sha256   its checksum, as sha256sum reads it
    build/bundle/oras                             the program that copies it
"""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from ci import evidence, oras, publish, toolchain
from ci.bundle.platform_chart import bundled_chart
from ci.errors import SetUpError
from ci.folders import PROJECT
from ci.images import preparation
from ci.images.built import REPOSITORY
from ci.images.image_lock import Image
from ci.steps import Steps
from gitops.argocd import render
from robotkube import VERSION
from robotkube.registry.bundles.adapters.making import BundleMaker
from robotkube.registry.bundles.core.contents import BundleContents
from robotkube.registry.charts.core.packing import build_tag
from robotkube.registry.images.adapters import bills
from robotkube.registry.publication.adapters import submission_folders
from robotkube.registry.publication.ports import SubmittedSources

FOLDER = PROJECT / "build" / "bundle"
CHART = PROJECT / "charts" / "robotkube"
ARGO_CD = "github.com/argoproj/argo-cd/v3"
PIECE_BYTES = 1 << 20


def make(folder: Path = FOLDER) -> Path:
    """Build what is missing, and write the bundle with its checksum and the program that copies it; its path."""
    prepared = preparation.everything()
    steps = Steps(2)
    with steps.step("read charts and evidence") as step:
        references = prepared.references()
        charts = submission_folders.all_charts(publish.CHARTS)
        submitted = publish.read_all(references, evidence.kept_folder(), charts)
        step.note = f"{len(submitted.charts)} charts"
    path = folder / f"robotkube-{VERSION}.tar"
    with steps.step("write the bundle") as step:
        contents = write(path, prepared.images, submitted, argocd_manifests(references))
        step.note = f"{path.stat().st_size / 1e6:.0f} MB"
    warn(contents)
    write_checksum(path)
    shutil.copy2(oras.ensure() / "oras", folder / "oras")
    return path


def write(path: Path, images: Sequence[Image], submitted: SubmittedSources, argocd: tuple[str, str]) -> BundleContents:
    """Write a bundle of these; `argocd` is the version of Argo CD and its objects."""
    maker = BundleMaker(VERSION, REPOSITORY)
    for image in images:
        item = maker.add_image(image.name, image.archive, image.archive.with_name(bills.FILE), image.ground)
        if not image.reference.endswith(f"@{item.digest}"):
            raise SetUpError(f"{image.archive}: holds {item.digest}, not {image.reference}; build the images again")
    for chart in submitted.charts:
        packed = chart.packed
        maker.add_chart(packed, kept_envelopes(submitted.kept, packed.name, packed.version, packed.digest))
    key = evidence.signing_key()
    references = {image.name: image.reference for image in images}
    maker.add_chart(bundled_chart(CHART, references, {f"key-{key.key_id}": key.public_key}), {})
    maker.add_manifests("argocd", *argocd)
    return maker.write(path)


def argocd_manifests(references: Mapping[str, str]) -> tuple[str, str]:
    """Version and objects of Argo CD, with images of the platform's."""
    source = toolchain.module_dir(ARGO_CD)
    text = (source / "manifests" / "install.yaml").read_text(encoding="utf-8")
    return source.name.partition("@v")[2], render.render(text, references)


def kept_envelopes(kept: Mapping[str, str], name: str, version: str, digest: str) -> dict[str, bytes]:
    """What was signed about exactly this digest: suite (or summary) -> envelope."""
    folder = f"evidence/{name}/{build_tag(version, digest)}/"
    return {
        path.removeprefix(folder).removesuffix(".json"): text.encode()
        for path, text in kept.items()
        if path.startswith(folder)
    }


def warn(contents: BundleContents) -> None:
    """Say which charts nobody verified yet."""
    without = [
        f"{item.name} {item.version}" for item in contents.of("chart") if not item.attached and item.name != "robotkube"
    ]
    if without:
        print(
            f"no evidence of {', '.join(without)} is kept here: publish them (make cluster), and make it again",
            file=sys.stderr,
        )


def write_checksum(path: Path) -> None:
    """Write the checksum beside a file."""
    hashed = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            hashed.update(piece)
    path.with_name(f"{path.name}.sha256").write_text(f"{hashed.hexdigest()}  {path.name}\n", encoding="utf-8")
