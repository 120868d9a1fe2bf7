"""A registry, as far as a bundle is looked for in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from robotkube.registry.charts.ports import Attachment


class PushedTo(Protocol):
    """An OCI registry; errors as those of ChartRegistry."""

    def manifest_digest(self, repository: str, reference: str) -> str | None:
        """The digest of the manifest that a tag or digest names; None if there is none."""
        ...

    def attachments(self, repository: str, subject: str) -> Sequence[Attachment]:
        """Everything attached to the manifest `subject`."""
        ...
