"""An OCI registry over HTTP (distribution specification 1.1) with basic authentication: charts and images go in,
digests come out.

Versions are never replaced: registries like Gitea delete the manifest a tag pointed to when another is written to it,
and releases that pin its digest would not find it again.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx

from robotkube.domain.charts_packing import MANIFEST_TYPE, PackedChart, sha256
from robotkube.domain.errors import InputError, UnavailableError

TIMEOUT = httpx.Timeout(30.0, write=120.0, read=120.0)
CHUNK_BYTES = 1 << 20
MANIFEST_BYTES_MAX = 4 << 20
INDEX_TYPE = "application/vnd.oci.image.index.v1+json"
ACCEPT = {"Accept": f"{MANIFEST_TYPE}, {INDEX_TYPE}"}


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


class Registry:
    """A client of one registry; `url` is `http(s)://host:port`. Not for use by several threads at once."""

    def __init__(self, url: str, user: str, password: str) -> None:
        auth = httpx.BasicAuth(user, password) if user else None
        self._url, self._user = url.rstrip("/"), user
        self._client = httpx.Client(base_url=f"{self._url}/v2/", auth=auth, timeout=TIMEOUT, trust_env=False)
        self._held: dict[str, str] = {}  # blob digest -> a repository of this registry that has it

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.disconnect()

    def disconnect(self) -> None:
        """Close the connections."""
        self._client.close()

    def push_chart(self, organisation: str, chart: PackedChart) -> str:
        """Push to `<organisation>/<chart name>` under the version as tag; returns the manifest's digest.

        Pushing the same chart again changes nothing. Raises InputError if the version is there with another digest.
        """
        repository = f"{organisation}/{chart.name}"
        self._refuse_replacing(repository, chart.tag, chart.digest)
        for data in (chart.config, chart.archive):
            self._put_bytes(repository, data)
        self._put_manifest(repository, chart.tag, chart.manifest)
        return chart.digest

    def push_image(self, repository: str, archive: Path, tag: str | None = None) -> str:
        """Push the image of an OCI layout archive (tar) to `repository`, by digest and under `tag` if given; returns
        its digest.

        Layers are streamed from the archive; those the registry has are not sent again.
        """
        blobs, digest = read_layout(archive)
        manifest = b"".join(blobs[digest].chunks())
        if tag:
            self._refuse_replacing(repository, tag, digest)
        if self.manifest_digest(repository, tag or digest) == digest:
            return digest
        document = json.loads(manifest)
        for entry in (document["config"], *document["layers"]):
            self._put_archived(repository, entry["digest"], blobs[entry["digest"]])
        self._put_manifest(repository, tag or digest, manifest)
        return digest

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The digest of the manifest that a tag or digest names; None if there is none. Computed from the bytes,
        not believed."""
        answer = self._call("GET", f"{repository}/manifests/{reference}", headers=ACCEPT)
        if answer.status_code == httpx.codes.NOT_FOUND:
            return None
        return sha256(self._expect(answer, f"manifest {repository}:{reference}", httpx.codes.OK).content)

    def list(self, repository: str) -> tuple[str, ...]:
        """The tags of a repository, sorted; empty if there is no such repository."""
        answer = self._call("GET", f"{repository}/tags/list")
        if answer.status_code == httpx.codes.NOT_FOUND:
            return ()
        found = self._expect(answer, f"tags of {repository}", httpx.codes.OK).json()
        return tuple(sorted(found.get("tags") or ()))

    def _refuse_replacing(self, repository: str, tag: str, digest: str) -> None:
        present = self.manifest_digest(repository, tag)
        if present not in (None, digest):
            raise InputError(
                f"{self._url}/{repository}:{tag} is {present}, what would be pushed is {digest}; "
                "a version is never replaced: raise `version` in Chart.yaml (or choose another tag)"
            )

    def _put_bytes(self, repository: str, data: bytes) -> None:
        digest = sha256(data)
        location = self._begin(repository, digest)
        if location:
            self._finish(repository, location, digest, data, len(data))

    def _put_archived(self, repository: str, digest: str, blob: ArchivedBlob) -> None:
        location = self._begin(repository, digest)
        if location:
            self._finish(repository, location, digest, blob.chunks(), blob.size)

    def _begin(self, repository: str, digest: str) -> str | None:
        """Where to send a blob; None if the registry has it, here or in a repository it can be taken from."""
        if self._call("HEAD", f"{repository}/blobs/{digest}").status_code == httpx.codes.OK:
            self._held.setdefault(digest, repository)
            return None
        source = self._held.get(digest)
        question = {"mount": digest, "from": source} if source else {}
        answer = self._call("POST", f"{repository}/blobs/uploads/", params=question)
        if answer.status_code == httpx.codes.CREATED:
            return None
        self._expect(answer, f"upload to {repository}", httpx.codes.ACCEPTED)
        return answer.headers["Location"]

    def _finish(self, repository: str, location: str, digest: str, content: bytes | Iterator[bytes], size: int) -> None:
        headers = {"Content-Type": "application/octet-stream", "Content-Length": str(size)}
        target = httpx.URL(f"{self._url}/v2/").join(location).copy_merge_params({"digest": digest})
        answer = self._call("PUT", str(target), content=content, headers=headers)
        self._expect(answer, f"blob {digest} of {repository}", httpx.codes.CREATED)
        self._held[digest] = repository

    def _put_manifest(self, repository: str, reference: str, manifest: bytes) -> None:
        answer = self._call(
            "PUT", f"{repository}/manifests/{reference}", content=manifest, headers={"Content-Type": MANIFEST_TYPE}
        )
        self._expect(answer, f"manifest {repository}:{reference}", httpx.codes.CREATED)

    def _call(self, method: str, path: str, **more: Any) -> httpx.Response:
        try:
            return self._client.request(method, path, **more)
        except httpx.HTTPError as error:
            raise UnavailableError(
                f"registry {self._url}: {method} {path.partition('?')[0]}: {error or type(error).__name__}"
            ) from error

    def _expect(self, answer: httpx.Response, what: str, code: int) -> httpx.Response:
        if answer.status_code == code:
            return answer
        text = answer.text[:300].strip()
        if answer.status_code in (httpx.codes.UNAUTHORIZED, httpx.codes.FORBIDDEN):
            raise InputError(
                f"registry {self._url}: {what}: "
                f"account {self._user or '(none)'} may not do this: {text}; check account and team"
            )
        if answer.status_code >= httpx.codes.INTERNAL_SERVER_ERROR:
            raise UnavailableError(f"registry {self._url}: {what}: {answer.status_code} {text}")
        raise InputError(f"registry {self._url}: {what}: answered {answer.status_code}, expected {int(code)}: {text}")


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
                elif member.name == "index.json" and member.size <= MANIFEST_BYTES_MAX:
                    index = json.loads(tar.extractfile(member).read())  # type: ignore[union-attr]
    except (OSError, tarfile.TarError, ValueError) as error:
        raise InputError(f"{archive}: no OCI layout archive: {error}") from error
    named = [entry["digest"] for entry in index.get("manifests", ())]
    if len(named) != 1 or named[0] not in blobs:
        raise InputError(
            f"{archive}: its index.json must name exactly one image that is in the archive; it names {len(named)}"
        )
    return blobs, named[0]
