"""Images in OCI layout archives on disk."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import DIGEST

CHUNK_BYTES = 1 << 20
INDEX_BYTES_MAX = 4 << 20


@dataclass(frozen=True)
class ArchivedBlob:
    """A blob inside an archive on disk: where its bytes are."""

    archive: Path
    offset: int
    size: int

    def chunks(self) -> Iterator[bytes]:
        """The bytes in pieces of at most CHUNK_BYTES."""
        left = self.size
        with self.archive.open("rb") as file:
            file.seek(self.offset)
            while left:
                data = file.read(min(CHUNK_BYTES, left))
                if not data:
                    raise InputError(f"{self.archive}: shorter than its own index says; build it again")
                left -= len(data)
                yield data


def read_image_manifest(data: bytes, where: str) -> dict[str, Any]:
    """The manifest of one image (`config`, `layers`) or the index of several (`manifests`); InputError when it is
    neither, or both, or does not say digest and size of every part."""
    try:
        document = read_json(data)
        parts = document["manifests"] if "manifests" in document else [document["config"], *document["layers"]]
        one_kind = ("manifests" in document) != ("layers" in document)
        well_formed = one_kind and all(_is_described(part) for part in parts)
    except (ValueError, TypeError, KeyError, AttributeError):
        well_formed = False
    if not well_formed:
        raise InputError(f"{where}: is neither the manifest of an image nor an index of some; push it again")
    read: dict[str, Any] = document
    return read


def _is_described(part: Mapping[str, Any]) -> bool:
    size = part["size"]
    return DIGEST.fullmatch(part["digest"]) is not None and type(size) is int and size >= 0


def read_archive(archive: Path) -> tuple[dict[str, ArchivedBlob], dict[str, Any]]:
    """The blobs of an OCI layout archive by digest, and its index. Raises InputError if it is not such an archive.
    Nothing is unpacked: links and folders in it are no blobs."""
    blobs: dict[str, ArchivedBlob] = {}
    index: Any = {}
    try:
        with tarfile.open(archive, "r:") as tar:
            for member in tar:
                if member.size < 0:  # tarfile would go back to where it was, without end
                    raise InputError(f"{archive}: no OCI layout archive: {member.name[:100]} has {member.size} bytes")
                if not member.isreg():
                    continue
                if member.name.startswith("blobs/sha256/"):
                    digest = "sha256:" + member.name.rpartition("/")[2]
                    blobs[digest] = ArchivedBlob(archive, member.offset_data, member.size)
                elif member.name == "index.json" and member.size <= INDEX_BYTES_MAX:
                    index = read_json(tar.extractfile(member).read())  # type: ignore[union-attr]
    except (OSError, tarfile.TarError, ValueError) as error:
        raise InputError(f"{archive}: no OCI layout archive: {error}") from error
    if not isinstance(index, dict) or not all(isinstance(one, dict) for one in index.get("manifests", ())):
        raise InputError(f"{archive}: no OCI layout archive: its index.json is of another form")
    return blobs, index


def read_layout(archive: Path) -> tuple[dict[str, ArchivedBlob], str]:
    """The blobs of an OCI layout archive by digest, and the digest of its one image. Raises InputError if it is not
    such an archive."""
    blobs, index = read_archive(archive)
    named = [entry["digest"] for entry in index.get("manifests", ())]
    if len(named) != 1 or named[0] not in blobs:
        raise InputError(
            f"{archive}: its index.json must name exactly one image that is in the archive; it names {len(named)}"
        )
    return blobs, named[0]
