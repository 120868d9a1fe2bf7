"""What every kind of cluster offers to the commands that use one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ci.cluster.images import Image
from ci.cluster.topology import Topology


@dataclass(frozen=True)
class NodeState:
    """A node as the API server sees it."""

    name: str
    role: str
    agent: str
    address: str
    ready: bool


class Provider(Protocol):
    """A cluster that can be started, used and removed without a trace."""

    def up(self, topology: Topology, images: Sequence[Image]) -> None:
        """Start the cluster or use the running one if it is healthy and equals; every node is Ready afterwards."""

    def down(self) -> tuple[str, ...]:
        """Remove everything; what it removed, a line for each kind, none when nothing was there. Raises SetUpError
        listing what could not be removed."""

    def status(self) -> str:
        """A table for people."""

    def kubeconfig(self) -> Path:
        """The administrator's kubeconfig."""

    def nodes(self) -> tuple[NodeState, ...]:
        """The nodes, in the order of the topology."""

    def import_images(self, images: Sequence[Image]) -> None:
        """Make images known to every node under their digest references."""

    def pull_from(self, url: str, username: str, password: str) -> None:
        """Let every node pull images of the platform's OCI registry, which is reached at `url`, with this account."""

    def volume_path(self, namespace: str, volume_claim: str) -> Path:
        """The host's folder behind a bound volume claim."""
