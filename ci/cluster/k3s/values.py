"""What the platform's chart is told of a k3s. Pure."""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Iterator, Sequence
from typing import Any

from ci.cluster.k3s.nodes import K3sNode

STORAGE = "local-path"  # its volumes are folders of the Node that uses them, so recordings stay with their agent


def chart_values(
    nodes: Sequence[K3sNode], api_servers: Collection[tuple[str, int]], classes: Collection[str]
) -> dict[str, Any]:
    """The class of volumes that k3s brings, where it is there, and the addresses that its network policies have to
    know, since it enforces them: of API servers and kubelets. `classes`: the names of StorageClasses."""
    servers = {address for address, _ in api_servers}
    hosts = [*sorted(servers), *(own for node in nodes if node.address in servers for own in _own_addresses(node))]
    api_server = {"to": [_block(host) for host in hosts], "ports": sorted({port for _, port in api_servers})}
    kubelets = {"to": [_block(address) for address in sorted({node.address for node in nodes if node.address})]}
    policies = {**({"apiServer": api_server} if servers else {}), **({"kubelets": kubelets} if kubelets["to"] else {})}
    return {**({"storage": {"className": STORAGE}} if STORAGE in classes else {}), "networkPolicies": policies}


def _own_addresses(node: K3sNode) -> Iterator[str]:
    """The two addresses that a Node itself has in the range of its pods, those of flannel and of the pods' bridge: by
    one of them its API server reaches the pods of another Node, as when it passes on what the command line asks."""
    for text in node.pod_ranges:
        network = ipaddress.ip_network(text)
        yield f"{network.network_address}/{network.max_prefixlen - 1}"


def _block(address: str) -> dict[str, Any]:
    return {"ipBlock": {"cidr": str(ipaddress.ip_network(address))}}
