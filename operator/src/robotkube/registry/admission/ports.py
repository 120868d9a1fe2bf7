"""What reconciling policies with the catalogue needs: its main with its history, a place for policies, and a memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from robotkube.foundation.forge.ports.repositories import Commit, MainHistory
from robotkube.registry.admission.core.listing import AllowedVersions


class CatalogueHistory(MainHistory, Protocol):
    """The catalogue's main, commit by commit."""

    def commit(self, commit: str) -> Commit:
        """A commit that is here, with its changes; DocumentError when it is too large to be read."""
        ...


class PolicyPlace(Protocol):
    """The place where the API server finds its policies."""

    def write(self, documents: Sequence[Mapping[str, Any]]) -> bool:
        """Replace the policies, all at once where the place can; False when they stood there already."""
        ...

    def intact(self) -> bool:
        """Return whether what was written last still stands there, as far as is known here; else it has to be written
        again."""
        ...


class ListingMemory(Protocol):
    """The last list, kept over a restart of the process."""

    def load(self) -> AllowedVersions:
        """The list that was saved last; an empty one when there is none."""
        ...

    def save(self, listing: AllowedVersions) -> None:
        """Keep this list in place of the one before."""
        ...
