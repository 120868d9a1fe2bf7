"""Rewrites what a builder made into an image that depends on nothing but its contents.

Builders stamp layers with times, list files in the order of the disk, leave the mount points of what was mounted
during the build and write history. Here every layer is written again: entries sorted by name, one modification time,
numeric owners only, links of one file pointing to the first of its names; the configuration is rebuilt from what has a
meaning at run time. The same contents give the same bytes, so a base layer is the same blob in all images that stand
on it. Layers are not compressed: nodes unpack them from a local archive, and a compressor's version would show in the
digest.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

FORMAT = "1"  # part of every image's key: raise it when other bytes are written for the same contents
EPOCH_SECONDS = 1_767_225_600  # 2026-01-01T00:00:00Z: the time of every file and image
EPOCH_TEXT = "2026-01-01T00:00:00Z"
MANIFEST_TYPE = "application/vnd.oci.image.manifest.v1+json"
CONFIG_TYPE = "application/vnd.oci.image.config.v1+json"
LAYER_TYPE = "application/vnd.oci.image.layer.v1.tar"
INDEX_TYPE = "application/vnd.oci.image.index.v1+json"
CONFIG_KEYS = ("User", "ExposedPorts", "Env", "Entrypoint", "Cmd", "WorkingDir", "Labels", "StopSignal")
KEPT_ATTRIBUTES = ("SCHILY.xattr.security.capability",)
BUILDER_LABELS = ("io.buildah.",)
BLOCK_BYTES = 1 << 20
MADE_BY_BUILDER = frozenset(
    {"etc/resolv.conf", "etc/hosts", "etc/hostname", "run/.containerenv", "run/secrets", "dev", "proc", "sys"}
)


@dataclass(frozen=True)
class Blob:
    """A content-addressed file: digest with its algorithm, size in bytes."""

    digest: str
    size: int

    def descriptor(self, media_type: str) -> dict[str, Any]:
        return {"mediaType": media_type, "digest": self.digest, "size": self.size}


@dataclass(frozen=True)
class NormalImage:
    """The manifest's digest and the layers, lowest first, of a written archive; `origins` maps digests of the builder's
    layers to those of their normal forms.
    """

    digest: str
    layers: tuple[Blob, ...]
    origins: Mapping[str, str]

    @property
    def size(self) -> int:
        """Bytes of all layers, unpacked and packed alike."""
        return sum(layer.size for layer in self.layers)


class Hashing:
    """A writer that hashes and counts what goes through it."""

    def __init__(self, target: IO[bytes]) -> None:
        self.target = target
        self.hash = hashlib.sha256()
        self.size = 0

    def write(self, data: bytes) -> int:
        self.hash.update(data)
        self.size += len(data)
        return self.target.write(data)

    def tell(self) -> int:
        return self.size

    def blob(self) -> Blob:
        return Blob("sha256:" + self.hash.hexdigest(), self.size)


def normalise_layer(raw: Path, target: Path, placeholders: frozenset[str] = frozenset()) -> Blob | None:
    """Write the layer `raw` (a tar) to `target` in normal form; None if nothing is in it.

    `placeholders` are paths without a leading slash at which the build mounted files of the machine: the empty files
    and folders that stay behind are left out, contents never are.
    """
    with tarfile.open(raw, "r:") as source, target.open("wb") as file:
        members = [m for m in source.getmembers() if not _is_placeholder(m, placeholders)]
        if not members:
            return None
        hashing = Hashing(file)
        with tarfile.open(fileobj=hashing, mode="w", format=tarfile.PAX_FORMAT) as out:  # type: ignore[call-overload]
            for entry, content in _entries(source, members):
                out.addfile(entry, content)
    return hashing.blob()


def _is_placeholder(member: tarfile.TarInfo, placeholders: frozenset[str]) -> bool:
    name = _clean(member.name)
    return name in placeholders and (member.isdir() or (member.isreg() and member.size == 0))


def _clean(name: str) -> str:
    return name.removeprefix("./").strip("/")


def _entries(
    source: tarfile.TarFile, members: Iterable[tarfile.TarInfo]
) -> Iterator[tuple[tarfile.TarInfo, IO[bytes] | None]]:
    """Entries in the order of their names; of the names of one file the first carries the content."""
    last = {_clean(m.name): m for m in members}
    first_name: dict[str, str] = {}
    for name in sorted(last):
        member = last[name]
        if not name:
            continue
        if not (member.isreg() or member.islnk()):
            yield _entry(member, name), None
            continue
        origin = _clean(member.linkname) if member.islnk() else name
        holder = last.get(origin)
        if holder is None:
            raise ValueError(f"layer: {name} is a link to {origin}, which is not in the layer")
        if origin in first_name:
            yield _link(holder, name, first_name[origin]), None
            continue
        first_name[origin] = name
        yield _entry(holder, name), source.extractfile(holder)


def _entry(member: tarfile.TarInfo, name: str) -> tarfile.TarInfo:
    entry = tarfile.TarInfo(name)
    entry.type = member.type
    entry.mode = member.mode & 0o7777
    entry.size = member.size if member.isreg() else 0
    entry.uid = member.uid
    entry.gid = member.gid
    entry.mtime = EPOCH_SECONDS
    entry.linkname = member.linkname if member.issym() else ""
    entry.devmajor, entry.devminor = member.devmajor, member.devminor
    entry.pax_headers = {k: v for k, v in member.pax_headers.items() if k in KEPT_ATTRIBUTES}
    if member.isreg():
        entry.type = tarfile.REGTYPE
    return entry


def _link(holder: tarfile.TarInfo, name: str, target: str) -> tarfile.TarInfo:
    """A further name of a file; mode and owner are repeated because some programs set them once more for every name."""
    entry = _entry(holder, name)
    entry.type = tarfile.LNKTYPE
    entry.linkname = target
    entry.size = 0
    entry.pax_headers = {}
    return entry


@dataclass(frozen=True)
class KnownLayer:
    """A layer in normal form inside an archive written earlier."""

    archive: Path
    blob: Blob

    def copy_to(self, target: Path) -> Blob:
        with tarfile.open(self.archive, "r:") as tar, target.open("wb") as out:
            content = tar.extractfile("blobs/sha256/" + self.blob.digest.removeprefix("sha256:"))
            if content is None:
                raise ValueError(f"{self.archive}: no layer {self.blob.digest}")
            shutil.copyfileobj(content, out, BLOCK_BYTES)
        return self.blob


def normalise_image(
    raw: Path,
    archive: Path,
    name: str,
    placeholders: frozenset[str] = frozenset(),
    known: Mapping[str, KnownLayer] | None = None,
) -> NormalImage:
    """Write the image of the folder `raw` (manifest.json and blobs named by hex digest) to `archive`, an OCI layout in
    a tar.

    The index names the image `<name>@<manifest digest>`, which is the name it gets in a containerd that imports the
    archive. `known` maps digests of the builder's layers to normal forms that need not be made again. Needs free space
    for the layers once more beside `archive` while it works.
    """
    blobs = archive.with_suffix(".blobs")
    blobs.mkdir(parents=True)
    manifest = json.loads((raw / "manifest.json").read_bytes())
    made = {
        entry["digest"]: _normal_blob(raw, blobs, entry["digest"], placeholders, known or {})
        for entry in manifest["layers"]
    }
    layers = [blob for entry in manifest["layers"] if (blob := made[entry["digest"]])]
    config = _config(json.loads(_blob_path(raw, manifest["config"]["digest"]).read_bytes()), layers)
    described = store_manifest(blobs, config, layers)
    write_archive(archive, blobs, described, f"{name}@{described.digest}")
    shutil.rmtree(blobs)
    origins = {digest: blob.digest for digest, blob in made.items() if blob}
    return NormalImage(described.digest, tuple(layers), origins)


def canonical_json(document: Any) -> bytes:
    """The bytes that are hashed: keys sorted, no spaces."""
    return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()


def _blob_path(raw: Path, digest: str) -> Path:
    return raw / digest.removeprefix("sha256:")


def _normal_blob(
    raw: Path, blobs: Path, digest: str, placeholders: frozenset[str], known: Mapping[str, KnownLayer]
) -> Blob | None:
    target = blobs / "layer"
    if digest in known:
        blob: Blob | None = known[digest].copy_to(target)
    else:
        blob = normalise_layer(_blob_path(raw, digest), target, placeholders)
    if blob is None:
        target.unlink()
    else:
        target.rename(blobs / blob.digest.removeprefix("sha256:"))
    return blob


def store_blob(blobs: Path, data: bytes) -> Blob:
    """Write `data` into the folder `blobs`, under its digest."""
    digest = hashlib.sha256(data).hexdigest()
    (blobs / digest).write_bytes(data)
    return Blob("sha256:" + digest, len(data))


def store_manifest(blobs: Path, config: bytes, layers: Sequence[Blob]) -> Blob:
    """Write an image's configuration and manifest into the folder `blobs`; the manifest."""
    document = {
        "schemaVersion": 2,
        "mediaType": MANIFEST_TYPE,
        "config": store_blob(blobs, config).descriptor(CONFIG_TYPE),
        "layers": [layer.descriptor(LAYER_TYPE) for layer in layers],
    }
    return store_blob(blobs, canonical_json(document))


def _config(raw: dict[str, Any], layers: list[Blob]) -> bytes:
    settings = {key: raw["config"][key] for key in CONFIG_KEYS if raw["config"].get(key)}
    labels = {k: v for k, v in settings.pop("Labels", {}).items() if not k.startswith(BUILDER_LABELS)}
    if labels:
        settings["Labels"] = labels
    return canonical_json(
        {
            "architecture": raw["architecture"],
            "os": raw["os"],
            "created": EPOCH_TEXT,
            "config": settings,
            "history": [{"created": EPOCH_TEXT} for _ in layers],  # one per layer: buildah refuses a base without
            "rootfs": {"type": "layers", "diff_ids": [layer.digest for layer in layers]},
        }
    )


def write_archive(
    archive: Path, blobs: Path, manifest: Blob, name: str, more: Mapping[str, bytes] | None = None
) -> None:
    """Pack blobs (files named by their hex digests) and an index that names one image into the tar `archive`, with
    `more` files beside."""
    entry = manifest.descriptor(MANIFEST_TYPE)
    entry["annotations"] = {"io.containerd.image.name": name, "org.opencontainers.image.ref.name": name}
    index = {"schemaVersion": 2, "mediaType": INDEX_TYPE, "manifests": [entry]}
    with tarfile.open(archive, "w", format=tarfile.PAX_FORMAT) as out:
        _add(out, "oci-layout", canonical_json({"imageLayoutVersion": "1.0.0"}))
        _add(out, "index.json", canonical_json(index))
        for path, data in (more or {}).items():
            _add(out, path, data)
        for blob in sorted(blobs.iterdir()):
            info = tarfile.TarInfo(f"blobs/sha256/{blob.name}")
            info.size = blob.stat().st_size
            info.mtime = EPOCH_SECONDS
            info.mode = 0o644
            with blob.open("rb") as content:
                out.addfile(info, content)
    with archive.open("rb") as file:
        os.fsync(file.fileno())


def _add(out: tarfile.TarFile, name: str, data: bytes) -> None:
    info = tarfile.TarInfo(name)
    info.size = len(data)
    info.mtime = EPOCH_SECONDS
    info.mode = 0o644
    out.addfile(info, BytesIO(data))
