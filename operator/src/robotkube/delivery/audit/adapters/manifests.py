"""Manifests of charts: from an OCI registry, saved as an OCI image layout, and read back from one.

The layout holds manifests only, no layers: what an audit asks is whether bytes of a digest are there, and where a tag
leads. In `index.json` each has the name under which it was asked for, `<repository>:<tag>` or `<repository>@<digest>`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robotkube.delivery.audit.ports import Manifests
from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import DIGEST
from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.core.packing import MANIFEST_TYPE
from robotkube.registry.charts.core.referrers import INDEX_TYPE

NAME_ANNOTATION = "org.opencontainers.image.ref.name"
LAYOUT = {"imageLayoutVersion": "1.0.0"}


class RegistryManifests:
    """The port Manifests on an OCI registry."""

    def __init__(self, registry: OciRegistry) -> None:
        self._registry = registry

    def manifest(self, repository: str, reference: str) -> bytes | None:
        """The manifest that a tag or digest names."""
        digest = self._registry.manifest_digest(repository, reference)
        return None if digest is None else self._registry.manifest(repository, digest)


class SavingManifests:
    """The port Manifests on another one; what it answers is kept in `folder` by `save`."""

    def __init__(self, manifests: Manifests, folder: Path) -> None:
        self._manifests = manifests
        self._folder = folder
        self._known: dict[str, bytes] = {}

    def manifest(self, repository: str, reference: str) -> bytes | None:
        """The manifest that a tag or digest names."""
        data = self._manifests.manifest(repository, reference)
        if data is not None:
            self._known[_name(repository, reference)] = data
        return data

    def save(self) -> None:
        """Write the layout in place of an earlier one. InputError when the disk refuses."""
        entries = []
        try:
            blobs = self._folder / "blobs" / "sha256"
            blobs.mkdir(parents=True, exist_ok=True)
            for name, data in sorted(self._known.items()):
                digest = sha256(data)
                (blobs / digest.removeprefix("sha256:")).write_bytes(data)
                descriptor = {"mediaType": MANIFEST_TYPE, "digest": digest, "size": len(data)}
                entries.append({**descriptor, "annotations": {NAME_ANNOTATION: name}})
            index = {"schemaVersion": 2, "mediaType": INDEX_TYPE, "manifests": entries}
            (self._folder / "oci-layout").write_text(json.dumps(LAYOUT), encoding="utf-8")
            (self._folder / "index.json").write_text(json.dumps(index, indent=1, sort_keys=True), encoding="utf-8")
        except OSError as error:
            raise InputError(f"--save {self._folder}: {error.strerror}") from error


class SavedManifests:
    """The port Manifests on a layout in `folder`. InputError when it is none."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        path = folder / "index.json"
        try:
            document = read_json(path.read_text(encoding="utf-8"))
            self._digests = {_ref_name(entry): str(entry["digest"]) for entry in document["manifests"]}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: no index of an OCI image layout ({error}); save it again") from error

    def manifest(self, repository: str, reference: str) -> bytes | None:
        """The manifest that a tag or digest names."""
        digest = self._digests.get(_name(repository, reference))
        if digest is None or not DIGEST.fullmatch(digest):
            return None
        path = self._folder / "blobs" / "sha256" / digest.removeprefix("sha256:")
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; save it again") from error
        if sha256(data) != digest:
            raise InputError(f"{path}: its bytes are {sha256(data)}")
        return data


def _name(repository: str, reference: str) -> str:
    return f"{repository}{'@' if DIGEST.fullmatch(reference) else ':'}{reference}"


def _ref_name(entry: Mapping[str, Any]) -> str:
    return str(entry["annotations"][NAME_ANNOTATION])
