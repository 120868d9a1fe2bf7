"""What removing needs of the cluster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

Object = Mapping[str, Any]


class RemovalCluster(Protocol):
    """The cluster as the remover's account may use it. UnavailableError when the API server does not answer,
    InputError when it refuses."""

    def inspections(self) -> Sequence[Object]:
        """All Inspections."""
        ...

    def pod(self, namespace: str, name: str) -> Object | None:
        """A pod; None when there is none."""
        ...

    def deployment(self, namespace: str, name: str) -> Object | None:
        """A Deployment; None when there is none."""
        ...

    def delete_pod(self, pod: Object, grace_seconds: int) -> bool:
        """Delete this pod as it was read; False when it is gone, or was changed meanwhile."""
        ...

    def patch_deployment(self, deployment: Object, patch: Sequence[Object]) -> bool:
        """Apply a JSON patch; False when the Deployment is gone, or was changed meanwhile."""
        ...

    def write_condition(self, inspection: str, condition: Object) -> None:
        """Write the condition into the status of an Inspection, beside those of others."""
        ...

    def report(self, inspection: str, uid: str, reason: str, text: str, warning: bool) -> None:
        """Write an Event on an Inspection."""
        ...
