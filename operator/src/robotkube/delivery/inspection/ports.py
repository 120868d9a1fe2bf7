"""What looking needs: nodes, workloads, what may run, and the Inspections in which strangers are reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.delivery.inspection.core.kubelet_pods import KubeletPod, RuntimePod
from robotkube.delivery.inspection.core.permitted import Permitted
from robotkube.delivery.inspection.core.strangers import Look, Stranger
from robotkube.errors import InputError
from robotkube.foundation.forge.ports.repositories import Commit, MainHistory


class NotInstalledError(InputError):
    """There is no place for Inspections: the kind, or the namespace, is not there."""


class Inspections(Protocol):
    """The Inspections of one namespace. UnavailableError when the API server does not answer, InputError when it
    refuses, of that NotInstalledError when there is no place for them."""

    def names(self) -> tuple[str, ...]:
        """Names of all Inspections."""
        ...

    def standing(self, prefix: str) -> Mapping[str, Mapping[str, Any]]:
        """The statuses of the Inspections whose names begin with `prefix`, by name."""
        ...

    def status(self, name: str) -> Mapping[str, Any] | None:
        """The status of an Inspection as it stands; empty when it has none yet, None when there is no such object."""
        ...

    def write(self, look: Look, status: Mapping[str, Any]) -> Mapping[str, Any]:
        """Replace the status of the look's Inspection, which is made when it is missing; the status that the API server
        says it has now, which admission may have changed."""
        ...

    def remove(self, name: str) -> None:
        """Delete an Inspection; nothing happens when there is none."""
        ...

    def report(self, look: Look, reason: str, stranger: Stranger) -> None:
        """Write an Event on the look's Inspection."""
        ...


@dataclass(frozen=True)
class NodeAddress:
    """A node with the address of its kubelet. `digests`: whether its runtime says by which digest an image was
    named."""

    name: str
    host: str
    port: int
    digests: bool = True


@dataclass(frozen=True)
class NodeReading:
    """What a kubelet lists: what it was told to run, and what its runtime has. The second is read first, so that a pod
    that starts meanwhile is in the first."""

    pods: tuple[KubeletPod, ...]
    running: tuple[RuntimePod, ...]


class Nodes(Protocol):
    """The nodes of the cluster and their kubelets. UnavailableError: no answer; InputError: refused, with the fix."""

    def addresses(self) -> Sequence[NodeAddress]:
        """All nodes, by name."""
        ...

    def read(self, node: NodeAddress) -> NodeReading:
        """What the node's kubelet lists; for several threads, one per node."""
        ...


class Workloads(Protocol):
    """Workloads of agents' namespaces. Errors as those of Nodes."""

    @property
    def kinds(self) -> Sequence[str]:
        """Kinds of workloads that there are and no release is made of."""
        ...

    def read(self, namespace: str, kind: str) -> Sequence[Mapping[str, Any]]:
        """The workloads of a kind, or the ConfigMaps, in a namespace, each with its namespace in its metadata; of
        `kinds` perhaps nothing else."""
        ...


class PermittedSource(Protocol):
    """What may run, as far as it is known here."""

    def refresh(self) -> None:
        """Read what has changed. UnavailableError and InputError leave what is known as it is."""
        ...

    def permitted(self) -> Permitted | None:
        """What may run now; None before it was read once."""
        ...


class DeploymentHistory(MainHistory, Protocol):
    """The deployment's main, commit by commit."""

    def commit(self, commit: str) -> Commit:
        """A commit that is here, with its changes; DocumentError when it is too large to be read."""
        ...
