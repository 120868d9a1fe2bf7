"""Images that publishers build: a folder with a Dockerfile becomes a reproducible archive with its bill."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import read_layout
from robotkube.registry.images.adapters.bills import make_bill
from robotkube.registry.images.adapters.build_contexts import copy_context
from robotkube.registry.images.adapters.buildah import BuildError
from robotkube.registry.images.adapters.normalising import MADE_BY_BUILDER, normalise_image
from robotkube.registry.images.ports import Engine

BILL_SUFFIX = ".bill.json"
DOCKERFILE = "Dockerfile"


@dataclass(frozen=True)
class OwnImage:
    """An image in the OCI layout archive `archive`; `bill` is the file with its bill of materials."""

    name: str
    digest: str
    archive: Path
    bill: Path


def build_image(folder: Path, name: str, archive: Path, engine: Engine, arguments: Mapping[str, str]) -> OwnImage:
    """Build the Dockerfile of `folder` with its build arguments; the same contents give the same digest."""
    tag = f"localhost/robotkube-own/{name}:latest"
    archive.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=archive.parent, prefix=f"{name}-") as work:
        context, exported, made = (Path(work) / part for part in ("context", "exported", "image.tar"))
        copy_context(folder, context)
        engine.build(context, context / DOCKERFILE, tag, arguments)
        engine.export(tag, exported)
        try:
            normalise_image(exported, made, f"localhost/{name}", MADE_BY_BUILDER)
        except ValueError as error:
            raise BuildError(f"{folder}: what {engine.program} built has no normal form: {error}") from error
        made.replace(archive)
    return describe_image(archive, name)


def describe_image(archive: Path, name: str) -> OwnImage:
    """The image of an archive of any builder, with the bill that is written beside it."""
    blobs, digest = read_layout(archive)
    manifest = json.loads(b"".join(blobs[digest].chunks()))
    if "layers" not in manifest:
        raise InputError(
            f"{archive}: is an index of several manifests; write one image: docker buildx build "
            f"--provenance=false --sbom=false --platform linux/amd64 --output type=oci,dest={archive.name}"
        )
    bill = archive.with_name(f"{archive.name}{BILL_SUFFIX}")
    bill.write_bytes(make_bill(archive, name, digest))
    return OwnImage(name, digest, archive, bill)
