"""Images in OCI layout archives on disk."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json

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


def read_layout(archive: Path) -> tuple[dict[str, ArchivedBlob], str]:
    """The blobs of an OCI layout archive by digest, and the digest of its one image. Raises InputError if it is not
    such an archive."""
    blobs: dict[str, ArchivedBlob] = {}
    index: dict[str, Any] = {}
    try:
        with tarfile.open(archive, "r:") as tar:
            for member in tar:
                if member.name.startswith("blobs/sha256/"):
                    digest = "sha256:" + member.name.rpartition("/")[2]
                    blobs[digest] = ArchivedBlob(archive, member.offset_data, member.size)
                elif member.name == "index.json" and member.size <= INDEX_BYTES_MAX:
                    index = read_json(tar.extractfile(member).read())  # type: ignore[union-attr]
    except (OSError, tarfile.TarError, ValueError) as error:
        raise InputError(f"{archive}: no OCI layout archive: {error}") from error
    named = [entry["digest"] for entry in index.get("manifests", ())]
    if len(named) != 1 or named[0] not in blobs:
        raise InputError(
            f"{archive}: its index.json must name exactly one image that is in the archive; it names {len(named)}"
        )
    return blobs, named[0]
