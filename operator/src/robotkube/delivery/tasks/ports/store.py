"""The TaskDescriptions of the cluster, as whoever writes or answers them needs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class TaskStore(Protocol):
    """TaskDescriptions of all agents' namespaces."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """The objects as Kubernetes holds them now (those being deleted included). Nobody changes metadata or spec of
        such an object: a task that changed is another object."""
        ...

    def patch_status(self, namespace: str, name: str, status: Mapping[str, Any]) -> bool:
        """Replace the given fields of the status; False when the task is gone."""
        ...

    def withdraw(self, namespace: str, name: str) -> bool:
        """Delete a task; False when it is gone already."""
        ...

    def report_on_task(self, task: Mapping[str, Any], reason: str, text: str) -> None:
        """Put a warning on the task (a Kubernetes Event); the same text on the same task once."""
        ...
