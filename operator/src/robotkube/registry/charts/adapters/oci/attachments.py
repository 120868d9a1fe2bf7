"""Artefacts attached to a manifest, listed by the registry's referrers API, or without one in the index under the
specification's fallback tag.

That index is read, extended and written back. That happens under a lock, and what was written is read again: another
writer that does not know the lock may have come between.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.registry.charts.adapters.oci.connection import MANIFEST_BYTES_MAX, RegistryConnection
from robotkube.registry.charts.core import referrers
from robotkube.registry.charts.core.referrers import (
    ARTEFACT_BYTES_MAX,
    ARTEFACT_MANIFEST_BYTES_MAX,
    ATTACHED_BYTES_MAX,
    EMPTY,
)
from robotkube.registry.charts.ports import Attachment

INDEX_TRIES_MAX = 5


class Attachments:
    """The attachments of all repositories of one OCI registry; `lock` is held while an index is changed."""

    def __init__(self, connection: RegistryConnection, lock: AbstractContextManager[Any]) -> None:
        self._connection = connection
        self._lock = lock

    def attach(
        self, repository: str, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str]
    ) -> str:
        """Attach `data` to the manifest `subject`; the artefact's digest."""
        if len(data) > ARTEFACT_BYTES_MAX:
            raise InputError(f"{len(data)} bytes cannot be attached to {subject}; at most {ARTEFACT_BYTES_MAX}")
        target = self._connection.manifest(repository, subject)
        if target is None:
            raise InputError(f"registry {self._connection.url}: {repository} has no manifest {subject} to attach to")
        manifest = referrers.artefact_manifest(subject, len(target), artifact_type, data, annotations)
        for blob in (EMPTY, data):
            self._connection.put_blob(repository, sha256(blob), blob, len(blob))
        self._list(repository, subject, [manifest])
        return sha256(manifest)

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """Everything attached to `subject`."""
        attached: list[Attachment] = []
        left = ATTACHED_BYTES_MAX
        for entry in self._entries(repository, subject):
            manifest = self._manifest(repository, entry["digest"])
            where = f"artefact {repository}@{entry['digest']}"
            digest, size, kind, annotations = referrers.read_artefact(manifest, subject, where)
            left -= size
            if left < 0:
                raise InputError(f"{repository}@{subject}: more than {ATTACHED_BYTES_MAX} bytes are attached")
            data = self._connection.blob(repository, digest, size)
            attached.append(Attachment(entry["digest"], kind, data, annotations))
        return attached

    def copy(self, source: str, target: str, subject: str, digests: Collection[str]) -> None:
        """Attach those artefacts of `source`, byte for byte, at `target`."""
        listed = {entry["digest"] for entry in self._entries(source, subject)}
        missing = sorted(set(digests) - listed)
        if missing:
            raise InputError(f"registry {self._connection.url}: not attached to {source}@{subject}: {missing[0]}")
        manifests = [self._manifest(source, digest) for digest in dict.fromkeys(digests)]
        for manifest in manifests:
            where = f"artefact {source}@{sha256(manifest)}"
            digest, size, _, _ = referrers.read_artefact(manifest, subject, where)
            self._connection.copy_blob(source, target, digest, size)
            self._connection.put_blob(target, sha256(EMPTY), EMPTY, len(EMPTY))
        if manifests:
            self._list(target, subject, manifests)

    def remove(self, repository: str, subject: str) -> None:
        """Remove all that is attached to `subject`, the index first: it lists nothing that is not there."""
        with self._lock:
            entries = self._entries(repository, subject)
            self._connection.delete_manifest(repository, referrers.fallback_tag(subject))
            for entry in entries:
                self._connection.delete_manifest(repository, entry["digest"])

    def _manifest(self, repository: str, digest: str) -> bytes:
        manifest = self._connection.manifest(repository, digest, ARTEFACT_MANIFEST_BYTES_MAX)
        if manifest is None:
            raise InputError(f"registry {self._connection.url}: {repository} lists {digest} but does not have it")
        return manifest

    def _entries(self, repository: str, subject: str) -> list[referrers.Entry]:
        kept = self._kept(repository, subject)
        return self._indexed(repository, subject) if kept is None else kept

    def _kept(self, repository: str, subject: str) -> list[referrers.Entry] | None:
        """What the registry itself lists; None when it lists nothing by itself."""
        pages = self._connection.referrers(repository, subject)
        return None if pages is None else referrers.read_pages(pages, f"referrers of {repository}@{subject}")

    def _indexed(self, repository: str, subject: str) -> list[referrers.Entry]:
        tag = referrers.fallback_tag(subject)
        index = self._connection.manifest(repository, tag, MANIFEST_BYTES_MAX)
        return referrers.read_index(index, f"index {repository}:{tag}")

    def _list(self, repository: str, subject: str, manifests: Sequence[bytes]) -> None:
        """Write the artefacts and have them all in the list of `subject`: the registry's own, or else the index."""
        kept = self._kept(repository, subject)
        if kept is None:
            self._index(repository, subject, manifests)
            return
        self._write(repository, manifests, {entry["digest"] for entry in kept})
        missing = {sha256(manifest) for manifest in manifests} - {
            entry["digest"] for entry in self._entries(repository, subject)
        }
        if missing:
            raise UnavailableError(
                f"registry {self._connection.url}: {repository}@{subject}: its referrers lack {min(missing)}, which "
                "was pushed; try again"
            )

    def _index(self, repository: str, subject: str, manifests: Sequence[bytes]) -> None:
        tag = referrers.fallback_tag(subject)
        where = f"index {repository}:{tag}"
        lines = [referrers.entry_of(manifest, where) for manifest in manifests]
        with self._lock:
            for attempt in range(INDEX_TRIES_MAX):
                index = referrers.extended(self._indexed(repository, subject), lines, where)
                if index is None:
                    return
                if not attempt:
                    for manifest in manifests:
                        self._put(repository, manifest)
                self._connection.put_manifest(repository, tag, index)
        if referrers.extended(self._indexed(repository, subject), lines, where) is not None:
            raise UnavailableError(f"{where}: others kept changing it; {INDEX_TRIES_MAX} tries")

    def _write(self, repository: str, manifests: Sequence[bytes], listed: Collection[str]) -> None:
        """Push those that the registry does not list, also where it has them: from before it kept lists."""
        for manifest in manifests:
            if sha256(manifest) not in listed:
                self._connection.put_manifest(repository, sha256(manifest), manifest)

    def _put(self, repository: str, manifest: bytes) -> None:
        digest = sha256(manifest)
        if self._connection.manifest(repository, digest) is None:
            self._connection.put_manifest(repository, digest, manifest)
