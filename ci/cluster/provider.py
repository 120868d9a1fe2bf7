"""What every kind of cluster offers to the commands that use one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ci.cluster.emulation.conditions import Measured, NetworkConditions, Traffic
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


class NetworkEmulator(Protocol):
    """What a provider can do to the cables of its nodes, outside of pods."""

    def check(self, wanted: Mapping[str, NetworkConditions]) -> None:
        """SetUpError when an agent has no node, or a part of what is asked of its cable cannot be done."""

    def apply(self, wanted: Mapping[str, NetworkConditions]) -> Mapping[str, tuple[str, ...]]:
        """Give agents' cables conditions, and all others none; by agent, where in the path each acts, in words.
        SetUpError when a part cannot be done: then no cable has any."""

    def probe(self) -> Mapping[str, Measured]:
        """What is measured of each cable that has conditions."""

    def cut(self, agent: str, seconds: float) -> None:
        """Open a hole in an agent's coverage: for so long every packet of its cable is dropped."""

    def traffic(self, agent: str) -> Mapping[str, Traffic]:
        """What the directions `up` and `down` of a cable have carried since it has its conditions."""

    def relay_dropped(self) -> int:
        """The packets of all cables that were lost by the emulation itself, and not by a condition."""

    def clear(self) -> None:
        """Take every condition away, also those of a run that was killed; nothing to do is fine."""


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

    def emulator(self) -> NetworkEmulator:
        """What gives the cables of nodes other conditions than the machine's."""
