"""Images as the gate will have them: a publisher's own are read from where that publisher pushed them, until a
submission brings them to where nodes pull them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robotkube.registry.charts.adapters.oci import OciRegistry
from robotkube.registry.charts.ports import Attachment
from robotkube.registry.publication.core.submissions import OWN_IMAGES, STAGING, pushed_place


class PushedImages:
    """Port ImageRegistry, as `account` sees it."""

    def __init__(self, registry: OciRegistry, account: str) -> None:
        self._registry = registry
        self._place = pushed_place(STAGING, account)

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The digest of the manifest that a tag or digest names; None if there is none."""
        return self._registry.manifest_digest(self._where(repository), reference)

    def manifest(self, repository: str, digest: str) -> bytes:
        """The image manifest or index of that digest."""
        return self._registry.manifest(self._where(repository), digest)

    def blob(self, repository: str, digest: str, bytes_max: int) -> bytes:
        """A blob of at most `bytes_max` bytes."""
        return self._registry.blob(self._where(repository), digest, bytes_max)

    def blob_pieces(self, repository: str, digest: str, bytes_max: int) -> Iterator[bytes]:
        """A blob of at most `bytes_max` bytes, piece by piece."""
        return self._registry.blob_pieces(self._where(repository), digest, bytes_max)

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """Everything attached to the manifest `subject`."""
        return self._registry.attachments(self._where(repository), subject)

    def _where(self, repository: str) -> str:
        organisation, _, name = repository.partition("/")
        return f"{self._place}/{name}" if organisation == OWN_IMAGES else repository
