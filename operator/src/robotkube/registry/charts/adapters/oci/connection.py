"""The calls of the distribution specification: manifests, blobs and referrers, bounded, as the account that is given.

Tags are never replaced: registries like Gitea delete the manifest a tag pointed to when another is written to it, and
releases that pin its digest would not find it again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.documents.core.digests import sha256
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.runtime.adapters.kept_connections import KeptConnections
from robotkube.registry.charts.adapters.oci.authentication import RegistryAuthentication
from robotkube.registry.charts.core.packing import MANIFEST_TYPE
from robotkube.registry.charts.core.referrers import INDEX_TYPE, PAGES_MAX

TIMEOUT = httpx.Timeout(30.0, write=120.0, read=120.0)
MANIFEST_BYTES_MAX = 4 << 20
PIECE_BYTES = 1 << 20
TEXT_CHARACTERS_MAX = 300  # of a registry's answer in a message
READING = {"Accept": f"{MANIFEST_TYPE}, {INDEX_TYPE}", "Accept-Encoding": "identity"}
NO_REFERRERS = (httpx.codes.NOT_FOUND, httpx.codes.METHOD_NOT_ALLOWED, httpx.codes.NOT_IMPLEMENTED)


class RegistryConnection:
    """One registry; `url` is `http(s)://host:port`. Several threads may use it."""

    def __init__(
        self, url: str, user: str, password: str, seconds: float | None = None, authority: Path | None = None
    ) -> None:
        """A connection that is made when it is needed. `seconds`: how long one connection, read or write may take,
        where TIMEOUT is too long. `authority`: file with an authority that is believed beside the usual ones."""
        self.url = url.rstrip("/")
        self._user = user
        self._client = KeptConnections(
            base_url=f"{self.url}/v2/",
            verify=certificate_authorities(trust_env=False, more=authority),
            timeout=seconds or TIMEOUT,
            trust_env=False,
        )
        self._authentication = RegistryAuthentication(self._client, user, password)
        self._lists_referrers = True  # until it says that it has no such list
        self._held: dict[str, str] = {}  # blob digest -> a repository of this registry that has it

    def disconnect(self) -> None:
        """Close the connections."""
        self._client.close()

    def manifest(self, repository: str, reference: str, bytes_max: int = MANIFEST_BYTES_MAX) -> bytes | None:
        """The manifest that a tag or digest names; None if there is none. InputError when it is not the bytes that a
        digest names, or more than `bytes_max`."""
        data = self._fetch(f"{repository}/manifests/{reference}", f"manifest {repository}:{reference}", bytes_max)
        if data is not None and reference.startswith("sha256:") and sha256(data) != reference:
            raise InputError(
                f"OCI registry {self.url}: {repository}@{reference} is {sha256(data)}; it cannot be trusted"
            )
        return data

    def blob(self, repository: str, digest: str, bytes_max: int) -> bytes:
        """The bytes of a blob. InputError when there is none, other bytes, or more than `bytes_max`."""
        data = self._fetch(f"{repository}/blobs/{digest}", f"blob {digest} of {repository}", bytes_max)
        if data is None:
            raise InputError(f"OCI registry {self.url}: {repository} has no blob {digest}; push it again")
        if sha256(data) != digest:
            raise InputError(f"OCI registry {self.url}: blob {digest} of {repository} has other bytes than it should")
        return data

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        """The bytes of a blob as they come. InputError when there is none or more than `bytes_max`, and at its end
        when they are other bytes."""
        what = f"blob {digest} of {repository}"
        path = f"{repository}/blobs/{digest}"
        hashed = hashlib.sha256()
        size = 0
        try:
            with closing(self._stream(path)) as answer:
                if answer.status_code != httpx.codes.OK:
                    answer.read()
                    self._expect(answer, what, httpx.codes.OK)
                for piece in answer.iter_raw(PIECE_BYTES):
                    hashed.update(piece)
                    size += len(piece)
                    if size > bytes_max:
                        raise InputError(
                            f"OCI registry {self.url}: {what} is longer than {bytes_max} bytes; it is not read"
                        )
                    yield piece
        except httpx.HTTPError as error:
            raise self._unavailable("GET", path, error) from error
        if f"sha256:{hashed.hexdigest()}" != digest:
            raise InputError(f"OCI registry {self.url}: {what} has other bytes than it should; push it again")

    def tags(self, repository: str) -> tuple[str, ...]:
        """The tags of a repository, sorted; empty if there is no such repository."""
        answer = self._call("GET", f"{repository}/tags/list")
        if answer.status_code == httpx.codes.NOT_FOUND:
            return ()
        listing = self._expect(answer, f"tags of {repository}", httpx.codes.OK).json()
        return tuple(sorted(listing.get("tags") or ()))

    def refuse_replacing(self, repository: str, tag: str, digest: str) -> bool:
        """Return whether `tag` is there already, with `digest`; InputError when it is there with another one."""
        present = self.manifest(repository, tag)
        if present is not None and sha256(present) != digest:
            raise InputError(
                f"{self.url}/{repository}:{tag} is {sha256(present)}, what would be pushed is {digest}; "
                "a version is never replaced: raise `version` in Chart.yaml (or choose another tag)"
            )
        return present is not None

    def referrers(self, repository: str, subject: str) -> list[bytes] | None:
        """The index of what is attached to `subject`, in pages, as the registry keeps it; None when it keeps none, so
        that its writers do, under the fallback tag."""
        pages: list[bytes] = []
        path = f"{repository}/referrers/{subject}"
        what = f"referrers of {repository}@{subject}"
        while path and self._lists_referrers:
            try:
                with closing(self._stream(path)) as answer:
                    if answer.status_code in NO_REFERRERS and not pages:
                        self._lists_referrers = False
                        return None
                    pages.append(self._body(answer, what, MANIFEST_BYTES_MAX))
                    path = _next_page(answer)
            except httpx.HTTPError as error:
                raise self._unavailable("GET", path, error) from error
            if path and len(pages) == PAGES_MAX:
                raise InputError(f"OCI registry {self.url}: {what}: more than {PAGES_MAX} pages; they are not read")
        return pages or None

    def put_manifest(self, repository: str, reference: str, manifest: bytes) -> None:
        """Write a manifest or index under a tag or its digest."""
        kind = read_json(manifest).get("mediaType", MANIFEST_TYPE)
        path = f"{repository}/manifests/{reference}"
        answer = self._call("PUT", path, content=manifest, headers={"Content-Type": kind})
        self._expect(answer, f"manifest {repository}:{reference}", httpx.codes.CREATED)

    def delete_manifest(self, repository: str, reference: str) -> None:
        """Delete the manifest or index of a tag or digest; one that is not there is success."""
        answer = self._call("DELETE", f"{repository}/manifests/{reference}")
        if answer.status_code != httpx.codes.NOT_FOUND:
            self._expect(answer, f"manifest {repository}:{reference}", httpx.codes.ACCEPTED)

    def put_blob(self, repository: str, digest: str, content: bytes | Iterator[bytes], size: int) -> None:
        """Write a blob unless the OCI registry has it, here or in a repository it can be mounted from."""
        location = self._begin(repository, digest)
        if location:
            self._finish(repository, location, digest, content, size)

    def copy_blob(self, source: str, target: str, digest: str, size: int) -> None:
        """Bring a blob of `source` to `target`: mounted when the OCI registry can, else through here."""
        self._held.setdefault(digest, source)
        location = self._begin(target, digest)
        if location:
            self._finish(target, location, digest, self.blob_pieces(source, digest, size), size)

    def _fetch(self, path: str, what: str, bytes_max: int) -> bytes | None:
        """The body of at most `bytes_max` bytes; None when there is nothing."""
        try:
            with closing(self._stream(path)) as answer:
                if answer.status_code == httpx.codes.NOT_FOUND:
                    return None
                return self._body(answer, what, bytes_max)
        except httpx.HTTPError as error:
            raise self._unavailable("GET", path, error) from error

    def _body(self, answer: httpx.Response, what: str, bytes_max: int) -> bytes:
        if answer.status_code != httpx.codes.OK:
            answer.read()
            self._expect(answer, what, httpx.codes.OK)
        data = bytearray()
        for chunk in answer.iter_raw():
            data += chunk
            if len(data) > bytes_max:
                raise InputError(f"OCI registry {self.url}: {what} is longer than {bytes_max} bytes; it is not read")
        return bytes(data)

    def _begin(self, repository: str, digest: str) -> str | None:
        """The address to send a blob to; None when that is not needed."""
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
        target = httpx.URL(f"{self.url}/v2/").join(location).copy_merge_params({"digest": digest})
        answer = self._call("PUT", str(target), content=content, headers=headers)
        self._expect(answer, f"blob {digest} of {repository}", httpx.codes.CREATED)
        self._held[digest] = repository

    def _call(self, method: str, path: str, **more: Any) -> httpx.Response:
        try:
            return self._send(method, path, **more)
        except httpx.HTTPError as error:
            raise self._unavailable(method, path, error) from error

    def _stream(self, path: str) -> httpx.Response:
        """An answer that is not read yet."""
        return self._send("GET", path, stream=True, headers=READING)

    def _send(self, method: str, path: str, stream: bool = False, **more: Any) -> httpx.Response:
        """The answer, as whom the registry wants to see; a body that can be read once only is sent once only."""
        for last in (isinstance(more.get("content"), Iterator), True):
            request = self._client.build_request(method, path, **more)
            self._authentication.authorise(request)
            answer = self._client.send(request, stream=stream, follow_redirects=stream)
            if last or answer.status_code != httpx.codes.UNAUTHORIZED:
                break
            if not self._authentication.learn(request, answer):
                break
            answer.close()
        return answer

    def _unavailable(self, method: str, path: str, error: httpx.HTTPError) -> UnavailableError:
        reason = what_failed(error, self.url)
        return UnavailableError(f"OCI registry {self.url}: {method} {path.partition('?')[0]}: {reason}")

    def _expect(self, answer: httpx.Response, what: str, code: int) -> httpx.Response:
        if answer.status_code == code:
            return answer
        text = answer.text[:TEXT_CHARACTERS_MAX].strip()
        if answer.status_code in (httpx.codes.UNAUTHORIZED, httpx.codes.FORBIDDEN):
            raise InputError(
                f"OCI registry {self.url}: {what}: "
                f"account {self._user or '(none)'} may not do this: {text}; check account and team"
            )
        if answer.status_code >= httpx.codes.INTERNAL_SERVER_ERROR:
            raise UnavailableError(f"OCI registry {self.url}: {what}: {answer.status_code} {text}")
        raise InputError(
            f"OCI registry {self.url}: {what}: answered {answer.status_code}, expected {int(code)}: {text}"
        )


def _next_page(answer: httpx.Response) -> str:
    """The address of the page that follows; empty after the last one."""
    link = answer.links.get("next", {}).get("url")
    return str(answer.url.join(link)) if link else ""
