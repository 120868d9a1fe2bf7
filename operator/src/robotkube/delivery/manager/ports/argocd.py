"""Argo CD as the manager needs it: requests to read Git again."""

from __future__ import annotations

from typing import Protocol


class ArgoCD(Protocol):
    """Requests to Argo CD to read Git again; both are best effort and bounded, and return whether they were
    received."""

    def hook(self, before: str, after: str) -> bool:
        """Send the signed, GitHub-shaped push event of main to the ApplicationSet controller."""
        ...

    def refresh(self, application: str) -> bool:
        """GET the Application with refresh=normal."""
        ...
