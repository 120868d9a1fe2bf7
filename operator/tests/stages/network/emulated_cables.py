"""A machine with a bridge and two nodes by cables, as the embedded cluster makes them, in network namespaces alone, and
the emulation that works on them."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from ipaddress import IPv4Network
from pathlib import Path
from typing import TypeVar

from ci.cluster.embedded.emulation.emulating import NetworkEmulation
from ci.cluster.embedded.emulation.probing import Ends
from ci.cluster.embedded.host.processes import Launcher, Process, start_ticks
from ci.cluster.embedded.host.records import ClusterFolders
from ci.cluster.embedded.network import host_network
from ci.cluster.embedded.network.addresses import AddressPlan
from ci.cluster.embedded.network.namespaces import inside
from ci.cluster_contract.provider import NodeState
from ci.machine import cgroups
from tests.stages.waiting import until

NODES = ("platform-0", "vehicle-00")
NOT_FILTERED = "! [ -e {0} ] || echo 0 > {0}".format("/proc/sys/net/bridge/bridge-nf-call-iptables")
T = TypeVar("T")


@dataclass
class EmulatedCables:
    """The machine `host` and its nodes; everything ends with their processes. `folders` are those of a cluster that is
    not there otherwise."""

    folders: ClusterFolders
    held: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def plan(self) -> AddressPlan:
        """Addresses of its own; also its name is."""
        name = self.folders.name
        return AddressPlan(name, *(IPv4Network(text) for text in ("10.92.0.0/24", "10.247.0.0/16", "10.99.0.0/16")))

    def start(self) -> NetworkEmulation:
        """Make all of it; the emulation of its cables."""
        for name in ("host", *NODES):
            self.held[name] = process = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
            until(lambda pid=process.pid: _separate(pid), name)
        self.said("host", "sh", "-c", NOT_FILTERED)
        pids = [self.held[node].pid for node in NODES]
        self.folders.processes.mkdir(parents=True)
        for node, pid in zip(NODES, pids, strict=True):
            record = asdict(Process(f"{node}.node", pid, start_ticks(pid) or 0, ("sleep",), ""))
            (self.folders.processes / f"{node}.node.json").write_text(json.dumps(record))
        self.on_host(lambda: (host_network.create_bridge(self.plan), host_network.connect(self.plan, pids)))
        states = [NodeState(n, n[:-2], n, str(self.plan.node(i)), True) for i, n in enumerate(NODES)]
        return NetworkEmulation(self.plan, Launcher(self.folders, Path()), lambda: states)

    def close(self) -> None:
        """End what holds the namespaces; the kernel takes them away."""
        for process in self.held.values():
            process.kill()
            process.wait(10)
        cgroups.remove(self.folders.name)

    def on_host(self, work: Callable[[], T]) -> T:
        """What `work` returns, done on the machine: programs that it starts are there as well."""
        return inside(self.namespace("host"), work)

    def namespace(self, place: str) -> Path:
        """The network namespace of a place."""
        return Path(f"/proc/{self.held[place].pid}/ns/net")

    def said(self, place: str, *command: str) -> str:
        """What a command says in the network namespace of a place."""
        return host_network.run(["nsenter", f"--net={self.namespace(place)}", *command])

    @property
    def ends(self) -> Ends:
        """The cable of the vehicle."""
        far, near = (str(self.plan.node(index)) for index in range(2))
        return Ends(self.namespace("vehicle-00"), near, self.namespace("platform-0"), far)


def _separate(pid: int) -> bool:
    return Path(f"/proc/{pid}/ns/net").readlink() != Path(f"/proc/{os.getpid()}/ns/net").readlink()
