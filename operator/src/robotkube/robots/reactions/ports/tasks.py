"""The TaskDescriptions that an event detector made itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class OwnTasks(Protocol):
    """The TaskDescriptions of a detector's own namespace. UnavailableError when the API server does not answer,
    RefusalError when it says no."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """All TaskDescriptions of the namespace."""
        ...

    def create(self, task: Mapping[str, Any]) -> None:
        """Create the object; one of that name that is there already is success."""
        ...

    def renew(self, name: str, now: int) -> bool:
        """Renew the lease at `now` (ns since 1970); False when there is no such object."""
        ...

    def delete(self, name: str) -> None:
        """Delete the object; one that is not there is success."""
        ...
