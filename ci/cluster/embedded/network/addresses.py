"""Names and addresses of a cluster: pure arithmetic, so that two clusters never meet and a test can say so."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network

from ci.cluster_contract.topology import NODES_MAX
from ci.errors import InputError

FIRST_NODE = 10


@dataclass(frozen=True)
class AddressPlan:
    """One cluster's ranges. The gateway (the host on the bridge) is the first address of `nodes`."""

    cluster: str
    nodes: IPv4Network
    pods: IPv4Network
    services: IPv4Network

    @property
    def bridge(self) -> str:
        """The bridge that joins the nodes; also the nftables table's name and the prefix of the host's veth ends."""
        return f"rk-{self.cluster}"

    @property
    def gateway(self) -> IPv4Address:
        """The host's address: API server, etcd and name service listen here."""
        return self.nodes[1]

    @property
    def hardware_address(self) -> str:
        """The bridge's own, locally administered. Left to the kernel it is the least of its ports', and another one
        with each that comes or goes: nodes would speak to the old one for half a minute."""
        return ":".join(f"{byte:02x}" for byte in (0x02, 0x52, 0x4B, *self.gateway.packed[1:]))

    @property
    def kubernetes_service(self) -> IPv4Address:
        """ClusterIP of the Service `kubernetes`: the first one of the range, as the API server takes it."""
        return self.services[1]

    def node(self, index: int) -> IPv4Address:
        """Address of the node number `index` (from 0) on the bridge."""
        return self.nodes[FIRST_NODE + self._checked(index)]

    def index(self, address: str) -> int:
        """The number of the node that has this address."""
        return int(IPv4Address(address)) - int(self.node(0))

    def pod_subnet(self, index: int) -> IPv4Network:
        """The /24 that the node number `index` gives to its pods."""
        return list(self.pods.subnets(new_prefix=24))[self._checked(index)]

    def link(self, index: int) -> str:
        """Name of the host's end of a node's cable (at most 15 characters, the kernel's bound)."""
        return f"{self.bridge}-{self._checked(index)}"

    @staticmethod
    def _checked(index: int) -> int:
        if not 0 <= index < NODES_MAX:
            raise InputError(f"node number {index} is outside 0 to {NODES_MAX - 1}")
        return index


def _plan(cluster: str, nodes: str, pods: str, services: str) -> AddressPlan:
    return AddressPlan(cluster, IPv4Network(nodes), IPv4Network(pods), IPv4Network(services))


PLANS = {
    plan.cluster: plan
    for plan in (
        _plan("demo", "10.89.0.0/24", "10.244.0.0/16", "10.96.0.0/16"),
        _plan("test", "10.90.0.0/24", "10.245.0.0/16", "10.97.0.0/16"),
    )
}


def plan_of(cluster: str) -> AddressPlan:
    """The plan of the cluster of that name; raises InputError naming the known ones."""
    if cluster not in PLANS:
        raise InputError(f"there is no cluster {cluster!r}: choose one of {', '.join(PLANS)}")
    return PLANS[cluster]
