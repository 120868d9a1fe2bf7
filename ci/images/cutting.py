"""Archives of images that are cut from another one: they hold what is their own (a layer, configuration, manifest); the
layers below are in the archive of the image they are cut from, their ground."""

from __future__ import annotations

import hashlib
import json
import shutil
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ci.images.services import Service, cut_layer
from robotkube.registry.images.adapters.buildah import BuildError
from robotkube.registry.images.adapters.normalising import (
    FORMAT,
    Blob,
    Hashing,
    NormalImage,
    canonical_json,
    store_manifest,
    write_archive,
)

CUT_FORMAT = "1"  # part of the key of every image that is cut: raise it when other bytes are written for the same files
TITLE, VERSION = "org.opencontainers.image.title", "org.opencontainers.image.version"


@dataclass(frozen=True)
class Ground:
    """The image that others are cut from: its archive, manifest and configuration."""

    archive: Path
    manifest: Mapping[str, Any]
    config: Mapping[str, Any]

    @property
    def shared(self) -> list[dict[str, Any]]:
        """Descriptors of the layers that every image cut from it has."""
        return list(self.manifest["layers"][:-1])

    @property
    def cut(self) -> str:
        """The digest of the layer that is cut."""
        return str(self.manifest["layers"][-1]["digest"])


def read_ground(archive: Path) -> Ground:
    """The image of an archive, as image builds write it."""
    with tarfile.open(archive, "r:") as layout:
        index = json.loads(_content(layout, "index.json"))
        manifest = json.loads(_content(layout, _path(index["manifests"][0]["digest"])))
        config = json.loads(_content(layout, _path(manifest["config"]["digest"])))
    if len(manifest["layers"]) < 2:
        raise BuildError(f"{archive}: nothing can be cut from one layer; build it again: make images")
    return Ground(archive, manifest, config)


def _content(layout: tarfile.TarFile, name: str) -> bytes:
    content = layout.extractfile(name)
    if content is None:
        raise BuildError(f"{layout.name!r}: no {name}; build the image again: make images")
    return content.read()


def _path(digest: str) -> str:
    return "blobs/" + digest.replace(":", "/")


def key_of_cut(
    service: Service, ground: Ground, started: Sequence[tuple[str, str]], files: Mapping[str, bytes], *more: str
) -> str:
    """16 hex digits that change when the service's image would: by what lies below its layer, by how it is started, by
    a file of `files` (path -> content), or by one of `more`."""
    total = hashlib.sha256()
    digests = {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
    below = {"shared": ground.shared, "config": _config(service, ground, ())}
    own = {"name": service.name, "started": [list(one) for one in started], "files": digests, "more": more}
    total.update(canonical_json({"format": [FORMAT, CUT_FORMAT], **below, **own}))
    return total.hexdigest()[:16]


def write_cut(
    service: Service,
    ground: Ground,
    started: Sequence[tuple[str, str]],
    files: frozenset[str],
    archive: Path,
    name: str,
) -> NormalImage:
    """Write the archive of the service's image, called `name`@<digest>, with what is its own."""
    blobs = archive.with_suffix(".blobs")
    blobs.mkdir(parents=True)
    layer = _write_layer(service, ground, started, files, blobs)
    layers = [*(Blob(entry["digest"], entry["size"]) for entry in ground.shared), layer]
    described = store_manifest(blobs, canonical_json(_config(service, ground, layers)), layers)
    write_archive(archive, blobs, described, f"{name}@{described.digest}")
    shutil.rmtree(blobs)
    return NormalImage(described.digest, tuple(layers), {})


def _write_layer(
    service: Service, ground: Ground, started: Sequence[tuple[str, str]], files: frozenset[str], blobs: Path
) -> Blob:
    part = blobs / "layer"
    with tarfile.open(ground.archive, "r:") as layout, part.open("wb") as file:
        content = layout.extractfile(_path(ground.cut))
        if content is None:
            raise BuildError(f"{ground.archive}: no layer {ground.cut}; build the image again: make images")
        hashing = Hashing(file)
        cut_layer(service, files, started, content, hashing)
    part.rename(blobs / hashing.blob().digest.removeprefix("sha256:"))
    return hashing.blob()


def _config(service: Service, ground: Ground, layers: list[Blob] | tuple[()]) -> dict[str, Any]:
    """The ground's configuration with the service's name, version and command, and `layers`."""
    labels = {**ground.config["config"].get("Labels", {}), TITLE: f"robotkube {service.name}", VERSION: service.version}
    settings = {**ground.config["config"], "Labels": labels, "Cmd": [service.command]}
    root = {"type": "layers", "diff_ids": [layer.digest for layer in layers]}
    return {**ground.config, "config": settings, "rootfs": root, "history": ground.config["history"][: len(layers)]}
