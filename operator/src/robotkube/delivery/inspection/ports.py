"""What looking needs: the Inspections of the cluster, and places where strangers are reported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from robotkube.delivery.inspection.core.strangers import Look, Stranger


class Inspections(Protocol):
    """The Inspections of one namespace. UnavailableError when the API server does not answer, InputError when it
    refuses."""

    def names(self) -> tuple[str, ...]:
        """Names of all Inspections."""
        ...

    def status(self, name: str) -> Mapping[str, Any] | None:
        """The status of an Inspection as it stands; empty when it has none yet, None when there is no such object."""
        ...

    def write(self, look: Look, status: Mapping[str, Any]) -> None:
        """Replace the status of the look's Inspection, which is made when it is missing."""
        ...

    def remove(self, name: str) -> None:
        """Delete an Inspection; nothing happens when there is none."""
        ...

    def report(self, look: Look, reason: str, stranger: Stranger) -> None:
        """Write an Event on the look's Inspection."""
        ...
