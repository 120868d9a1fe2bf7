"""Nodes and pods as the embedded cluster has them, of network namespaces alone: a machine with a bridge, nodes on it by
cables, on each node a bridge with its pods. Nothing of it has a name outside, and all of it ends with its processes.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from ci.cluster.embedded.host.processes import Process, start_ticks
from ci.cluster.embedded.network.host_network import run, run_inside
from ci.cluster.embedded.network.namespaces import inside
from ci.cluster.embedded.network_policies import enforcement
from ci.cluster.embedded.network_policies.nftables_rules import AttachedPod, Rulebook
from robotkube.foundation.kubernetes.core.network_policies import NetworkPolicy
from tests.stages.network.nft_meaning import PlacedPod
from tests.stages.waiting import until

HOST = "host"
HOST_ADDRESS, NODES_PREFIX = "10.89.0.1", "10.89.0"
ANSWER_SECONDS_MAX = 10.0
LOOK_SECONDS = 0.01
PREPARED = """
for name in all default; do
  ! [ -e /proc/sys/net/ipv6/conf/$name/disable_ipv6 ] || echo 1 > /proc/sys/net/ipv6/conf/$name/disable_ipv6
done
echo 1 > /proc/sys/net/ipv4/ip_forward
echo 0 > /proc/sys/net/ipv4/conf/all/rp_filter
! [ -e /proc/sys/net/bridge/bridge-nf-call-iptables ] || echo {filtered} > /proc/sys/net/bridge/bridge-nf-call-iptables
ip link set lo up
"""
DROPPED = re.compile(r'counter packets (\d+) bytes \d+ drop comment "([^"]*)"')
STRANGE = "not under its own address"  # or not IPv4; of a pod that nobody knows also its answers to ARP
T = TypeVar("T")


@dataclass
class RealNodes:
    """The namespaces of a machine, its nodes and their pods, by name: `host`, a node's, `<namespace>/<pod>`."""

    pods: Sequence[PlacedPod]
    held: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self) -> None:
        """Make all of it; the nodes have no rules."""
        self._hold(HOST, filtered=False)
        run_inside(self.pid(HOST), ["link add nodes type bridge", f"addr add {HOST_ADDRESS}/24 dev nodes"])
        run_inside(self.pid(HOST), ["link set nodes up"])
        for index, node in enumerate(self.nodes):
            self._node(index, node)
        for node in self.nodes:
            for other in self.nodes:
                if other != node:
                    run_inside(
                        self.pid(node), [f"route add {subnet(self.nodes.index(other))} via {self.address(other)}"]
                    )
        for pod in self.pods:
            self.attach(pod)

    def close(self) -> None:
        """End what holds the namespaces; the kernel takes them away."""
        for process in self.held.values():
            process.kill()
        for process in self.held.values():
            process.wait(ANSWER_SECONDS_MAX)

    @property
    def nodes(self) -> list[str]:
        """The names of the nodes."""
        return sorted({pod.node for pod in self.pods})

    def pid(self, place: str) -> int:
        """The process that holds a namespace."""
        return self.held[place].pid

    def address(self, node: str) -> str:
        """A node's address among the nodes."""
        return f"{NODES_PREFIX}.{10 + self.nodes.index(node)}"

    def holder(self, node: str) -> Process:
        """The process that holds a node, as a cluster records it."""
        pid = self.pid(node)
        return Process(f"{node}{enforcement.NODE}", pid, start_ticks(pid) or 0, ("sleep",), "")

    def attach(self, pod: PlacedPod) -> None:
        """Connect one more pod to its node, as the plug-in `bridge` does."""
        place = key(pod)
        self._hold(place, filtered=False)
        node, own = self.pid(pod.node), self.pid(place)
        run_inside(node, [f"link add {pod.port} type veth peer name eth0 netns {own}"])
        run_inside(node, [f"link set {pod.port} master cni0 up"])
        run(["nsenter", f"--net=/proc/{node}/ns/net", "bridge", "link", "set", "dev", pod.port, "hairpin", "on"])
        gateway = pod.peer.address.rpartition(".")[0] + ".1"
        run_inside(
            own, [f"addr add {pod.peer.address}/24 dev eth0", "link set eth0 up", f"route add default via {gateway}"]
        )

    def _hold(self, place: str, filtered: bool) -> None:
        process = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
        self.held[place] = process
        until(lambda: _namespace(process.pid) != _namespace(os.getpid()) and _runs(process.pid, "sleep"), place)
        self.inside(place, "sh", "-ec", PREPARED.format(filtered=int(filtered)))

    def _node(self, index: int, node: str) -> None:
        self._hold(node, filtered=True)
        own = self.pid(node)
        machine = self.pid(HOST)
        gateway = subnet(index).replace(".0/24", ".1/24")
        run_inside(machine, [f"link add cable{index} type veth peer name eth0 netns {own}"])
        run_inside(machine, [f"link set cable{index} master nodes up"])
        run_inside(own, [f"addr add {self.address(node)}/24 dev eth0", "link set eth0 up", "link add cni0 type bridge"])
        run_inside(own, [f"addr add {gateway} dev cni0", "link set cni0 up"])
        run_inside(machine, [f"route add {subnet(index)} via {self.address(node)}"])

    def inside(self, place: str, *command: str, text: str | None = None) -> str:
        """What a command says in a namespace."""
        return run(["nsenter", f"--net=/proc/{self.pid(place)}/ns/net", *command], text)

    def enforce(self, policies: Sequence[NetworkPolicy], pods: Sequence[PlacedPod] | None = None) -> None:
        """Give each node the rules of these policies."""
        known = self.pods if pods is None else pods
        book = Rulebook(policies, [pod.peer for pod in known])
        for node in self.nodes:
            attached = [AttachedPod(pod.port, pod.peer) for pod in known if pod.node == node]
            enforcement.apply(self.holder(node), book.node(attached))

    def drops(self) -> Mapping[str, int]:
        """The number of packets that were dropped, by the words beside the rule."""
        counts: dict[str, int] = {}
        for node in self.nodes:
            for number, words in DROPPED.findall(self.inside(node, "nft", "list", "ruleset")):
                counts[words] = counts.get(words, 0) + int(number)
        return counts

    def open(self, place: str, made: Callable[[], T]) -> T:
        """What `made` returns, called in a namespace: a socket that it makes stays there."""

        return inside(Path(f"/proc/{self.pid(place)}/ns/net"), made)

    @contextlib.contextmanager
    def served(self, place: str, protocol: str, port: int) -> Iterator[socket.socket]:
        """A socket that listens at every address of a place."""
        kind = socket.SOCK_STREAM if protocol == "TCP" else socket.SOCK_DGRAM
        with self.open(place, lambda: socket.socket(socket.AF_INET, kind)) as server:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind(("0.0.0.0", port))  # noqa: S104 - of a namespace
            if protocol == "TCP":
                server.listen(16)
            server.setblocking(False)
            yield server

    def reaches(self, source: str, target: str, address: str, at: tuple[str, int], served: int = 0) -> bool:
        """Whether a connection, or a datagram, comes from one place to a server at another; `served`: the server's own
        port, where a Service translates. That it does not is seen by a drop that is counted."""
        protocol, port = at
        with self.served(target, protocol, served or port) as server:
            before = self._judged()
            with self.open(source, lambda: _first(address, at)):
                return self._arrives(server, protocol, before)

    def _arrives(self, server: socket.socket, protocol: str, before: int) -> bool:
        arrived: list[bool] = []
        seen = before

        def decided() -> bool:
            nonlocal seen
            now = self._judged()
            seen = 0 if now < seen else seen  # rules that were replaced meanwhile count from the beginning
            received = _taken(server, protocol)
            if received or now > seen:
                arrived.append(received)
            return bool(arrived)

        until(decided, "it arrives or is dropped", ANSWER_SECONDS_MAX)
        return arrived[0]

    def _judged(self) -> int:
        return sum(self.drops().values())


def key(pod: PlacedPod) -> str:
    """The name of a pod's namespace."""
    return f"{pod.peer.namespace}/{pod.peer.name}"


def subnet(index: int) -> str:
    """The addresses of a node's pods."""
    return f"10.244.{index + 1}.0/24"


def _first(address: str, at: tuple[str, int]) -> socket.socket:
    """A socket that has sent its first packet."""
    kind = socket.SOCK_STREAM if at[0] == "TCP" else socket.SOCK_DGRAM
    made = socket.socket(socket.AF_INET, kind)
    made.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        made.connect((address, at[1]))
    if at[0] == "UDP":
        made.send(b"first")
    return made


def _taken(server: socket.socket, protocol: str) -> bool:
    with contextlib.suppress(BlockingIOError):
        if protocol == "UDP":
            return server.recv(100) == b"first"
        server.accept()[0].close()
        return True
    return False


def _namespace(pid: int) -> str:
    return str(Path(f"/proc/{pid}/ns/net").readlink())


def _runs(pid: int, program: str) -> bool:
    return Path(f"/proc/{pid}/comm").read_text(encoding="ascii").strip() == program
