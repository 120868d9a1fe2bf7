"""What the manager reads of Kubernetes, and the tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from robotkube.domain.observation import ApplicationState, PodState
from robotkube.domain.placement import NodeState


class TaskStore(Protocol):
    """TaskDescriptions of all agents' namespaces."""

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """The objects as Kubernetes holds them now (those being deleted included). Nobody changes metadata or spec of
        one that was given: a task that changed is another object."""
        ...

    def patch_status(self, namespace: str, name: str, status: Mapping[str, Any]) -> bool:
        """Replace the given fields of the status; False when the task is gone."""
        ...

    def withdraw(self, namespace: str, name: str) -> bool:
        """Delete a task; False when it is gone already."""
        ...

    def tell(self, task: Mapping[str, Any], reason: str, text: str) -> None:
        """Put a warning on the task (a Kubernetes Event); the same text on the same task once."""
        ...


class Cluster(Protocol):
    """What the manager sees of the cluster; values are snapshots kept up to date by watches."""

    def nodes(self) -> Sequence[NodeState]:
        """Nodes of agents."""
        ...

    def applications(self) -> Mapping[str, ApplicationState]:
        """Argo CD Applications by name."""
        ...

    def pods(self, release: str) -> Sequence[PodState]:
        """Pods of a release, named `<namespace>/<release>` (label app.kubernetes.io/instance)."""
        ...

    def tell_node(self, node: str, reason: str, text: str) -> None:
        """Put a warning beside a Node (a Kubernetes Event in the platform's namespace); the same text once."""
        ...
