"""What a kind of cluster offers to the commands that use one, in two parts: Nodes that are agents', and on top of them
all that an installation and a scenario's run need. Whoever uses a cluster knows these two and not which kind it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from ci.cluster_contract.network_conditions import Measured, NetworkConditions, Traffic
from ci.cluster_contract.topology import Topology
from ci.images.image_lock import Image


@dataclass(frozen=True)
class NodeState:
    """A node as the API server sees it, for one of its agents: `guest` is that one's number beside the node's host, 0
    where it is the host."""

    name: str
    role: str
    agent: str
    address: str
    ready: bool
    guest: int = 0


@dataclass(frozen=True)
class ChartProfile:
    """What the platform's chart is told on a kind of cluster: files of values in the chart's folder, and values upon
    these. `registry`: HOST/PATH from which the cluster pulls images; empty: by the names that they were built with.
    `added` are annotations of namespaces that are made before the chart: where there are any, the cluster was not made
    here, and what has not got them is somebody else's."""

    files: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    registry: str = ""
    added: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ServicePort:
    """A port of a Service, with the Service's address inside of the cluster."""

    namespace: str
    name: str
    address: str
    port: int


@dataclass(frozen=True)
class WayOfAPerson:
    """How a person at this machine gets to a port of a Service: host and port, and the command that has to run
    meanwhile, which is empty where nothing has to."""

    host: str
    port: int
    command: str = ""

    @property
    def instruction(self) -> str:
        """Host and port, and after the command, if there is one."""
        return f"http://{self.host}:{self.port}/{f' while this runs: {self.command}' if self.command else ''}"


Reach = Callable[[ServicePort], tuple[str, int]]
"""Gives host and port at which this process reaches a Service, as long as it runs."""


def directly(service: ServicePort) -> tuple[str, int]:
    """Reach a Service at its own address: this machine is one of the cluster's."""
    return service.address, service.port


class Volumes(Protocol):
    """Files in volume claims. Paths are relative to the claim's volume."""

    def use(self, volume_claims: Sequence[tuple[str, str]]) -> None:
        """Make the volumes of these claims (namespace, name) reachable; SetUpError says what is in the way."""

    def place(self, volume_claim: tuple[str, str], folder: Path) -> bool:
        """Put a folder of this machine into a claim under its own name; True when another one had been there."""

    def make(self, volume_claim: tuple[str, str], folder: str) -> None:
        """Make a folder in a claim, which pods of the platform's user may write to."""

    def fetch(self, volume_claim: tuple[str, str], path: str) -> Path:
        """A file of a claim, as a file of this machine with what is in it now; SetUpError when it cannot be read."""

    def end_of(self, volume_claim: tuple[str, str], path: str, length: int) -> bytes:
        """The last bytes of a file, so many at most; none when there is no such file."""


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


class OwnMachines(Protocol):
    """What can be done to the machines of Nodes, by the kind of cluster that made them."""

    def pull_from(self, url: str, username: str, password: str, authorities: str = "") -> None:
        """Let every node pull images of the platform's OCI registry, which is reached at `url`, with this account;
        `authorities`: who may have signed its certificate (PEM)."""

    def emulator(self) -> NetworkEmulator:
        """What gives the cables of nodes other conditions than the machine's."""

    def stop_node(self, name: str) -> None:
        """End a node's machine with everything on it; it stays registered."""

    def start_node(self, name: str) -> None:
        """Let a stopped node come back."""

    def cpu_folder(self) -> Path:
        """The folder of control groups that count the CPU time of all that this cluster is made of."""


class Provider(NodesProvider, Protocol):
    """A cluster that can be started or taken, used, and removed without a trace."""

    def up(self, topology: Topology, images: Sequence[Image]) -> None:
        """Start the cluster, or use the one that is there if it is healthy and equals; every node is Ready
        afterwards."""

    def kubeconfig(self) -> Path:
        """The administrator's kubeconfig."""

    def work(self) -> Path:
        """A folder for files of what is installed; it goes with the cluster."""

    def chart_profile(self) -> ChartProfile:
        """What the platform's chart is told here, beside images and agents."""

    def reach(self, service: ServicePort) -> tuple[str, int]:
        """See Reach."""

    def way_of_a_person(self, service: ServicePort) -> WayOfAPerson:
        """How a person gets to a Service, also when this process has ended."""

    def volumes(self) -> AbstractContextManager[Volumes]:
        """Files in volume claims, for as long as the block lasts."""

    def machines(self) -> OwnMachines | None:
        """What can be done to the machines of the Nodes; None where this kind did not make them."""
