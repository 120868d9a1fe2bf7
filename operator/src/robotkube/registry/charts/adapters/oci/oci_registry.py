"""One OCI registry: charts and images pushed and pulled, evidence attached and copied with its chart."""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from robotkube.errors import InputError
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.registry.charts.adapters.oci.attachments import Attachments
from robotkube.registry.charts.adapters.oci.connection import RegistryConnection
from robotkube.registry.charts.adapters.oci.image_layouts import read_image_manifest, read_layout
from robotkube.registry.charts.core import unpacking
from robotkube.registry.charts.core.packing import PackedChart, PulledChart
from robotkube.registry.charts.core.unpacking import read_chart_manifest, unpack_chart
from robotkube.registry.charts.ports import Attachment

PLATFORMS_MAX = 8  # of one index of images


class OciRegistry:
    """A client of one OCI registry, port ChartRegistry; `url` is `http(s)://host:port`. Several threads may use it.

    `lock` is held while a list of attachments is changed: all clients of one process that attach share one. A version
    is never replaced. `seconds` bounds each connection, read and write more tightly than RegistryConnection does;
    `authority` is a file with a certificate authority that is believed beside the usual ones. With a password or
    without: the registry says what it wants to see, the account itself or a token for it."""

    def __init__(
        self,
        url: str,
        user: str,
        password: str,
        lock: AbstractContextManager[Any] | None = None,
        seconds: float | None = None,
        authority: Path | None = None,
    ) -> None:
        self._connection = RegistryConnection(url, user, password, seconds, authority)
        self._attachments = Attachments(self._connection, lock or threading.Lock())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.disconnect()

    def disconnect(self) -> None:
        """Close the connections."""
        self._connection.disconnect()

    def push_chart(self, organisation: str, chart: PackedChart, tag: str = "") -> str:
        """Push to `<organisation>/<chart name>` under `tag`, or the version when it is empty; the manifest's digest.

        Pushing the same chart again changes nothing. InputError if the tag is there with another digest."""
        repository = f"{organisation}/{chart.name}"
        tag = tag or chart.tag
        self._connection.refuse_replacing(repository, tag, chart.digest)
        for data in (chart.config, chart.archive):
            self._connection.put_blob(repository, sha256(data), data, len(data))
        self._connection.put_manifest(repository, tag, chart.manifest)
        return chart.digest

    def push_image(self, repository: str, archive: Path, tag: str | None = None, ground: Path | None = None) -> str:
        """Push the image of an OCI layout archive (tar) to `repository`, by digest and under `tag` if given; returns
        its digest.

        Layers are streamed from the archive, or from that of `ground` when they are not in it; those the OCI registry
        has are not sent again."""
        own, digest = read_layout(archive)
        blobs = {**read_layout(ground)[0], **own} if ground else own
        manifest = b"".join(blobs[digest].chunks())
        if tag:
            self._connection.refuse_replacing(repository, tag, digest)
        if self.manifest_digest(repository, tag or digest) == digest:
            return digest
        document = read_json(manifest)
        for entry in (document["config"], *document["layers"]):
            blob = blobs.get(entry["digest"])
            if blob is None:
                raise InputError(f"{archive}: has no blob {entry['digest']}; build the image again")
            self._connection.put_blob(repository, entry["digest"], blob.chunks(), blob.size)
        self._connection.put_manifest(repository, tag or digest, manifest)
        return digest

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The digest of the manifest that a tag or digest names; None if there is none. Computed from the bytes,
        not believed."""
        manifest = self._connection.manifest(repository, reference)
        return None if manifest is None else sha256(manifest)

    def manifest(self, repository: str, digest: str) -> bytes:
        """The bytes of the manifest or index of that digest; InputError when it is not there."""
        manifest = self._connection.manifest(repository, digest)
        if manifest is None:
            raise InputError(
                f"OCI registry {self._connection.url}: {repository} has no manifest {digest}; push it again"
            )
        return manifest

    def blob(self, repository: str, digest: str, bytes_max: int) -> bytes:
        """The bytes of the blob of that digest; InputError when it is not there or has more than `bytes_max`."""
        return self._connection.blob(repository, digest, bytes_max)

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        """The pieces of a blob, one by one; InputError at its end when these were not the digest's bytes."""
        return self._connection.blob_pieces(repository, digest, bytes_max)

    def list(self, repository: str) -> tuple[str, ...]:
        """The tags of a repository, sorted; empty if there is no such repository."""
        return self._connection.tags(repository)

    def pull_chart(self, repository: str, digest: str) -> PulledChart:
        """The chart of that digest; InputError when it is not there, is no chart, or is beyond a bound."""
        where = f"{repository}@{digest}"
        manifest = self._chart_manifest(repository, digest)
        config, archive = read_chart_manifest(manifest, where)
        return unpack_chart(
            where,
            manifest,
            self._connection.blob(repository, config.digest, config.size),
            self._connection.blob(repository, archive.digest, archive.size),
        )

    def attach(
        self, repository: str, subject: str, artifact_type: str, data: bytes, annotations: Mapping[str, str]
    ) -> str:
        """Attach `data` to the manifest `subject`; the artefact's digest. The same again changes nothing."""
        return self._attachments.attach(repository, subject, artifact_type, data, annotations)

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """Everything attached to `subject`, in the order of attaching."""
        return self._attachments.attachments(repository, subject)

    def copy_chart(self, source: str, target: str, digest: str, tag: str, attachments: Collection[str]) -> None:
        """Copy a chart and the named attachments, no others; blobs are mounted when the OCI registry can."""
        manifest = self._chart_manifest(source, digest)
        present = self._connection.refuse_replacing(target, tag, digest)
        self._attachments.copy(source, target, digest, attachments)
        if present:
            return
        for blob in read_chart_manifest(manifest, f"{source}@{digest}"):
            self._connection.copy_blob(source, target, blob.digest, blob.size)
        self._connection.put_manifest(target, tag, manifest)

    def copy_image(self, source: str, target: str, digest: str, artifact_type: str) -> None:
        """Copy an image, of an index every image, with the attachments of that type; layers are mounted when the OCI
        registry can."""
        manifest = self.manifest(source, digest)
        attached = [
            attachment.digest
            for attachment in self.attachments(source, digest)
            if attachment.artifact_type == artifact_type
        ]
        document = read_image_manifest(manifest, f"{source}@{digest}")
        if len(document.get("manifests", ())) > PLATFORMS_MAX:
            raise InputError(
                f"{source}@{digest}: is an index of more than {PLATFORMS_MAX} images; push fewer platforms"
            )
        for described in document.get("manifests", ()):
            self.copy_image(source, target, described["digest"], artifact_type)
        if self.manifest_digest(target, digest) is None:
            for blob in (document["config"], *document["layers"]) if "layers" in document else ():
                self._connection.copy_blob(source, target, blob["digest"], blob["size"])
            self._connection.put_manifest(target, digest, manifest)
        self._attachments.copy(source, target, digest, attached)

    def remove_image(self, repository: str, digest: str) -> None:
        """Remove an image with all that is attached to it; the OCI registry removes blobs that nothing has any more."""
        self._attachments.remove(repository, digest)
        self._connection.delete_manifest(repository, digest)

    def _chart_manifest(self, repository: str, digest: str) -> bytes:
        manifest = self._connection.manifest(repository, digest, unpacking.MANIFEST_BYTES_MAX)
        if manifest is None:
            raise InputError(f"OCI registry {self._connection.url}: {repository} has no chart {digest}; push it again")
        return manifest
