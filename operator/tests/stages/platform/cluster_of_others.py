"""A cluster that somebody else made, for who takes one: Nodes by names and labels of its own, without network policies
and admission, whose containerd knows no image but that of sandboxes, and pulls all others from a registry beside it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from ci import distribution
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.folders import PROJECT
from ci.images.image_lock import SANDBOX, Image
from ci.machine import network_policies
from tests.stages.platform.lent_cluster import LentCluster, believe, write_agents
from tests.stages.registry.distribution import open_to_all

NODES = "/api/v1/nodes"


def each_alone(topology: Topology) -> list[list[NodeSpec]]:
    """A machine for each node."""
    return [[node] for node in topology.nodes]


@contextmanager
def made(
    name: str, binaries: Path, machines: Sequence[Sequence[NodeSpec]], built: Sequence[Image], folder: Path
) -> Iterator[LentCluster]:
    """The cluster, with a Node for each of the machines, called machine-0 and so on, and nothing that makes it that of
    the nodes of a scenario that it is for; it is removed afterwards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(network_policies.VARIABLE, network_policies.OFF)
        provider = Embedded(name, binaries, admission_files.OFF)
    nodes = [_machine(f"machine-{number}", own) for number, own in enumerate(machines)]
    provider.down()
    try:
        provider.up(Topology(tuple(nodes)), [image for image in built if image.name == SANDBOX])
        _strip(provider)
        with open_to_all(distribution.ensure() / "registry", folder, str(provider.plan.gateway)) as registry:
            _open_port(provider, registry.host)
            believe(provider.folders.hosts, registry.host, registry.authority)
            agents = folder / "agents.yaml"
            write_agents(agents, {node.name: own for node, own in zip(nodes, machines, strict=True)})
            kubectl = (str(binaries / "kubectl"), "--kubeconfig", str(provider.kubeconfig()))
            yield LentCluster(kubectl, provider.kubeconfig(), registry.host, registry.authority, agents, _attempt)
    finally:
        provider.down()


def _attempt(*command: str, seconds: float) -> subprocess.CompletedProcess[str]:
    """See lent_cluster.Attempt: this machine reaches it."""
    return subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=seconds, check=False)


def _machine(name: str, nodes: Sequence[NodeSpec]) -> NodeSpec:
    """A machine as large as these nodes of a scenario, but not larger than this one, with the volumes that the last
    one's role has."""
    cpu, memory = sum(node.cpu_millicores for node in nodes), sum(node.memory_bytes for node in nodes)
    cpu = min(cpu, 1000 * (os.cpu_count() or 1))
    memory = min(memory, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return replace(nodes[-1], name=name, cpu_millicores=cpu, memory_bytes=memory)


def _strip(provider: Embedded) -> None:
    """Take from Nodes what made them agents'."""
    api = provider.api()
    for node in api.get(NODES)["items"]:
        named = dict.fromkeys(label for label in node["metadata"]["labels"] if label.startswith("robotkube.io/"))
        api.merge(f"{NODES}/{node['metadata']['name']}", {"metadata": {"labels": named}, "spec": {"taints": None}})


def _open_port(provider: Embedded, host: str) -> None:
    """Let Nodes reach the registry, which listens at this machine's address on their bridge."""
    rule = f"insert rule inet {provider.plan.bridge} input tcp dport {host.rpartition(':')[2]} accept"
    subprocess.run(["nft", *rule.split()], check=True, timeout=10)
