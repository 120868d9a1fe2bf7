"""What the audit needs besides Git: the manifests of charts in an OCI registry, or in a folder that was saved."""

from __future__ import annotations

from typing import Protocol


class Manifests(Protocol):
    """Manifests of charts. UnavailableError when the registry does not answer, InputError when what it answers is not
    what was asked for."""

    def manifest(self, repository: str, reference: str) -> bytes | None:
        """The manifest that a tag or digest names; None if there is none. `repository` is `<organisation>/<chart>`."""
        ...
