"""OCI image layouts in one tar: written from archives on this machine without unpacking them, and read by their list
of contents.

    oci-layout, index.json
    blobs/sha256/<hex>     each once, whatever has it
"""

from __future__ import annotations

import hashlib
import io
import tarfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import canonical_json, sha256
from robotkube.registry.bundles.core.contents import CONTENTS_BYTES_MAX, CONTENTS_TYPE, BundleContents, read_contents
from robotkube.registry.charts.adapters.oci import ArchivedBlob, read_archive, read_image_manifest
from robotkube.registry.charts.core.packing import MANIFEST_TYPE
from robotkube.registry.charts.core.referrers import INDEX_TYPE
from robotkube.registry.images.adapters.normalising import EPOCH_SECONDS

MANIFEST_BYTES_MAX = 4 << 20
BLOBS = "blobs/sha256/"

Blob = ArchivedBlob | bytes


def chunks(blob: Blob) -> Iterator[bytes]:
    """The bytes of a blob, in pieces."""
    if isinstance(blob, bytes):
        yield blob
    else:
        yield from blob.chunks()


def size(blob: Blob) -> int:
    """How many bytes a blob has."""
    return len(blob) if isinstance(blob, bytes) else blob.size


@dataclass
class Layout:
    """A layout that is put together: `blobs` by digest, and the `manifests` that its index names."""

    blobs: dict[str, Blob] = field(default_factory=dict)
    manifests: list[dict[str, Any]] = field(default_factory=list)

    def add(self, data: bytes) -> str:
        """Add bytes; their digest."""
        digest = sha256(data)
        self.blobs.setdefault(digest, data)
        return digest

    def name(self, digest: str, artifact_type: str = "", **annotations: str) -> None:
        """Have the index name a manifest that was added."""
        entry: dict[str, Any] = {"mediaType": MANIFEST_TYPE, "digest": digest, "size": size(self.blobs[digest])}
        entry |= {"artifactType": artifact_type} if artifact_type else {}
        entry |= {"annotations": annotations} if annotations else {}
        self.manifests.append(entry)

    def write(self, path: Path) -> None:
        """Write the tar; the same layout gives the same bytes. InputError when a blob has not the bytes of its
        digest."""
        part = path.with_name(f"{path.name}.part")
        path.parent.mkdir(parents=True, exist_ok=True)
        index = {"schemaVersion": 2, "mediaType": INDEX_TYPE, "manifests": self.manifests}
        with tarfile.open(part, "w", format=tarfile.PAX_FORMAT) as out:
            _add(out, "oci-layout", canonical_json({"imageLayoutVersion": "1.0.0"}))
            _add(out, "index.json", canonical_json(index))
            for digest, blob in sorted(self.blobs.items()):
                _add(out, BLOBS + digest.removeprefix("sha256:"), blob, digest)
        part.replace(path)


class _Pieces(io.RawIOBase):
    """A blob as a file that is read once, hashed on its way."""

    def __init__(self, blob: Blob) -> None:
        self._pieces = chunks(blob)
        self._piece = b""
        self._at = 0
        self.hash = hashlib.sha256()

    def read(self, count: int = -1) -> bytes:
        parts = []
        while count > 0:
            if self._at == len(self._piece):
                self._piece = next(self._pieces, b"")
                self._at = 0
                if not self._piece:
                    break
            part = self._piece[self._at : self._at + count]
            self._at, count = self._at + len(part), count - len(part)
            self.hash.update(part)
            parts.append(part)
        return b"".join(parts)


def _add(out: tarfile.TarFile, name: str, blob: Blob, digest: str = "") -> None:
    info = tarfile.TarInfo(name)
    info.size = size(blob)
    info.mtime = EPOCH_SECONDS
    info.mode = 0o644
    pieces = _Pieces(blob)
    out.addfile(info, pieces)
    if digest and f"sha256:{pieces.hash.hexdigest()}" != digest:
        where = blob.archive if isinstance(blob, ArchivedBlob) else name
        raise InputError(f"{where}: blob {digest} has other bytes than it should; build it again: make images")


@dataclass(frozen=True)
class Bundle:
    """A bundle on disk: what it says that it holds, where each blob is, and the entry of its list in the index."""

    path: Path
    contents: BundleContents
    blobs: Mapping[str, ArchivedBlob]
    digest: str

    def read(self, digest: str, bytes_max: int = MANIFEST_BYTES_MAX) -> bytes:
        """A small blob whole; InputError when it is missing, longer, or other bytes."""
        return _read(self.path, self.blobs, digest, bytes_max)

    def parts(self, digest: str) -> list[str]:
        """Digests of a manifest's configuration and layers; InputError when it is none, or that of several images."""
        return _parts(self.path, self.blobs, digest)

    def check(self) -> None:
        """InputError unless every blob has the bytes of its digest."""
        for digest, blob in self.blobs.items():
            hashed = hashlib.sha256()
            for piece in blob.chunks():
                hashed.update(piece)
            if f"sha256:{hashed.hexdigest()}" != digest:
                raise InputError(
                    f"{self.path}: {digest} has other bytes than it should; fetch or make the bundle again"
                )


def read_bundle(path: Path) -> Bundle:
    """The bundle in a file; InputError when it is none, or lacks a part of something that it says it holds."""
    blobs, index = read_archive(path)
    named = [entry for entry in index.get("manifests", ()) if entry.get("artifactType") == CONTENTS_TYPE]
    if len(named) != 1:
        raise InputError(
            f"{path}: no bundle: its index.json names {len(named)} lists of contents; make one: make bundle"
        )
    digest = str(named[0].get("digest"))
    listing = _read(path, blobs, _parts(path, blobs, digest)[-1], CONTENTS_BYTES_MAX)
    bundle = Bundle(path, read_contents(listing, str(path)), blobs, digest)
    missing = sorted(_missing(bundle, bundle.contents.digests()))
    if missing:
        raise InputError(f"{path}: lacks {len(missing)} of its parts, such as {missing[0]}; fetch or make it again")
    return bundle


def _missing(bundle: Bundle, digests: Iterable[str]) -> set[str]:
    wanted = set(digests)
    present = wanted & bundle.blobs.keys()
    return (wanted - present) | {part for one in present for part in bundle.parts(one) if part not in bundle.blobs}


def _parts(path: Path, blobs: Mapping[str, ArchivedBlob], digest: str) -> list[str]:
    manifest = read_image_manifest(_read(path, blobs, digest, MANIFEST_BYTES_MAX), f"{path}: {digest}")
    if "manifests" in manifest:
        raise InputError(f"{path}: {digest} is an index of several images; a bundle names each by itself")
    elsewhere = [part["digest"] for part in manifest["layers"] if _comes_from_elsewhere(part)]
    if elsewhere:
        raise InputError(f"{path}: {digest} has layer {elsewhere[0]} from elsewhere, which no registry is given")
    return [part["digest"] for part in (manifest["config"], *manifest["layers"])]


def _comes_from_elsewhere(layer: Mapping[str, Any]) -> bool:
    """Return whether who copies leaves a layer out, and who pulls fetches it from an address that the manifest
    names."""
    kind = str(layer.get("mediaType"))
    return bool(layer.get("urls")) or "foreign" in kind or "nondistributable" in kind


def _read(path: Path, blobs: Mapping[str, ArchivedBlob], digest: str, bytes_max: int) -> bytes:
    blob = blobs.get(digest)
    if blob is None or blob.size > bytes_max:
        raise InputError(
            f"{path}: {digest} is missing or longer than {bytes_max} bytes; fetch or make the bundle again"
        )
    data = b"".join(blob.chunks())
    if sha256(data) != digest:
        raise InputError(f"{path}: {digest} has other bytes than it should; fetch or make the bundle again")
    return data
