"""Port of test namespaces that somebody makes with their own rights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from robotkube.registry.suites.ports.suites import NamespaceObjects, Object


class OwnNamespaces(Protocol):
    """Makes and removes such namespaces. UnavailableError when the API server does not answer, InputError when it
    refuses."""

    def missing_rights(self, namespace: str) -> Sequence[str]:
        """What the account may not do of what it takes, in words."""
        ...

    def remove_left_behind(self) -> Sequence[str]:
        """Remove those whose makers have ended; their names."""
        ...

    def make(self, namespace: str, seconds: float) -> None:
        """Make it, with all that a test namespace has; `seconds` from now somebody else may remove it."""
        ...

    def refusal(self, namespace: str, pod: Object) -> str:
        """Why the cluster would not take a pod there; empty when it would."""
        ...

    def objects(self, namespace: str) -> NamespaceObjects:
        """What is in it."""
        ...

    def remove(self, namespace: str) -> None:
        """Have it removed with all that is in it; one that is not there is success."""
        ...

    def is_gone(self, namespace: str) -> bool:
        """Return whether there is no such namespace."""
        ...
