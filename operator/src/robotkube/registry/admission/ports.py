"""What following the catalogue needs: its main with its history, and a place for policies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from robotkube.foundation.forge.ports.repositories import Commit, MainHistory


class CatalogueHistory(MainHistory, Protocol):
    """The catalogue's main, commit by commit."""

    def commit(self, commit: str) -> Commit:
        """A commit that is here, with its changes; DocumentError when it is too large to be read."""
        ...


class PolicyPlace(Protocol):
    """Where the API server finds its policies."""

    def write(self, documents: Sequence[Mapping[str, Any]]) -> bool:
        """Replace the policies, all at once; False when they stood there already."""
        ...
