"""Images of the platform's OCI registry as archives that every engine can load: its address inside the cluster is none
that an engine outside of it could ask."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from robotkube.errors import InputError
from robotkube.registry.charts.adapters.oci import read_image_manifest
from robotkube.registry.images.adapters.normalising import Blob, write_archive
from robotkube.registry.suites.core.image_checks import ImageReference, manifest_of

LAYER_BYTES_MAX = 8 << 30
DIGITS = 12


class Blobs(Protocol):
    """The OCI registry, as far as base images need it."""

    def manifest(self, repository: str, digest: str) -> bytes:
        """The manifest of that digest."""
        ...

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        """A blob, piece by piece."""
        ...


def local_tag(reference: ImageReference) -> str:
    """The name that an engine has for it."""
    number = reference.digest.removeprefix("sha256:")[:DIGITS]
    return f"localhost/robotkube-base/{reference.repository.rpartition('/')[2]}:{number}"


def fetch_base(registry: Blobs, reference: ImageReference, platform: str, archive: Path) -> None:
    """Write the image for `platform` (`linux/amd64`) to the OCI layout archive `archive`, which docker loads as well;
    its name is `local_tag`."""
    where = str(reference)
    data = registry.manifest(reference.repository, reference.digest)
    digest = reference.digest
    document = read_image_manifest(data, where)
    if "manifests" in document:
        named = manifest_of(document, platform)
        if named is None:
            raise InputError(f"{where}: is not built for {platform}; give another base with --base")
        digest = named
        data = registry.manifest(reference.repository, named)
        document = read_image_manifest(data, where)
    with tempfile.TemporaryDirectory(dir=archive.parent, prefix="base-") as folder:
        blobs = Path(folder)
        (blobs / _hex(digest)).write_bytes(data)
        for entry in (document["config"], *document["layers"]):
            _fetch(registry, reference.repository, entry["digest"], blobs)
        tag = local_tag(reference)
        write_archive(archive, blobs, Blob(digest, len(data)), tag, {"manifest.json": _for_docker(document, tag)})


def _fetch(registry: Blobs, repository: str, digest: str, blobs: Path) -> None:
    target = blobs / _hex(digest)
    if target.exists():
        return
    with target.open("wb") as out:
        for piece in registry.blob_pieces(repository, digest, LAYER_BYTES_MAX):
            out.write(piece)


def _hex(digest: str) -> str:
    return digest.removeprefix("sha256:")


def _for_docker(manifest: Mapping[str, Any], tag: str) -> bytes:
    paths = [f"blobs/sha256/{_hex(entry['digest'])}" for entry in (manifest["config"], *manifest["layers"])]
    return json.dumps([{"Config": paths[0], "RepoTags": [tag], "Layers": paths[1:]}]).encode()
