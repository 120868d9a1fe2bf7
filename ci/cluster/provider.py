"""What a kind of cluster offers to the commands that use one, in two parts: Nodes that are agents', and on top of them
all that an installation and a scenario's run need. Whoever uses a cluster knows these two and not which kind it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

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


@dataclass(frozen=True)
class ChartProfile:
    """What the platform's chart is told on a kind of cluster: files of values in the chart's folder, and values upon
    these."""

    files: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)


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


class NodesProvider(Protocol):
    """Nodes with the labels of agents, and a way to be rid of all that made them so."""

    @property
    def name(self) -> str:
        """Which cluster of its kind."""

    @property
    def kind(self) -> str:
        """The kind of cluster, as people choose it and reports name it."""

    @property
    def lacks(self) -> tuple[str, ...]:
        """What this kind cannot give though others can, each a sentence for the output and the report."""

    def down(self) -> tuple[str, ...]:
        """Remove everything that was made or added; what it removed, a line for each, none when nothing was there.
        Raises SetUpError listing what could not be removed."""

    def kept(self) -> tuple[str, ...]:
        """What `down` leaves on purpose, a line for each."""

    def status(self) -> str:
        """A table for people."""

    def nodes(self) -> tuple[NodeState, ...]:
        """The nodes, in the order of the topology."""


class Provider(NodesProvider, Protocol):
    """A cluster that can be started, used and removed without a trace. This machine reaches the addresses of its
    Services, the forge's among them, and the folders of its volumes."""

    def up(self, topology: Topology, images: Sequence[Image]) -> None:
        """Start the cluster or use the running one if it is healthy and equals; every node is Ready afterwards."""

    def kubeconfig(self) -> Path:
        """The administrator's kubeconfig."""

    def work(self) -> Path:
        """A folder for files of what is installed; it goes with the cluster."""

    def chart_profile(self) -> ChartProfile:
        """What the platform's chart is told here, beside images and agents."""

    def import_images(self, images: Sequence[Image]) -> None:
        """Make images known to every node under their digest references."""

    def pull_from(self, url: str, username: str, password: str, authorities: str = "") -> None:
        """Let every node pull images of the platform's OCI registry, which is reached at `url`, with this account;
        `authorities`: who may have signed its certificate (PEM)."""

    def volume_path(self, namespace: str, volume_claim: str) -> Path:
        """The host's folder behind a bound volume claim."""

    def emulator(self) -> NetworkEmulator:
        """What gives the cables of nodes other conditions than the machine's."""

    def stop_node(self, name: str) -> None:
        """End a node's machine with everything on it; it stays registered."""

    def start_node(self, name: str) -> None:
        """Let a stopped node come back."""

    def cpu_folder(self) -> Path:
        """The folder of control groups that count the CPU time of all that this cluster is made of."""
