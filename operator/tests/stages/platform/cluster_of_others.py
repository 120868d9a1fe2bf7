"""A cluster that somebody else made, for who takes one: Nodes by names and labels of its own, without network policies
and admission, whose containerd knows no image but that of sandboxes, and pulls all others from a registry beside it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import yaml

from ci import distribution
from ci.cluster.embedded.admission import admission_files
from ci.cluster.embedded.nodes import pulling
from ci.cluster.embedded.provider import Embedded
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.images.image_lock import SANDBOX, Image
from ci.machine import network_policies
from tests.stages.registry.distribution import open_to_all

BUILT_AS = pulling.REGISTRY
PATH = "fleet/robotkube"  # its last part is that of the names that images were built with
NODES = "/api/v1/nodes"


@dataclass(frozen=True)
class ClusterOfOthers:
    """One that runs. `agents` is a file that says which of its Nodes are whose."""

    provider: Embedded
    registry: str
    authority: Path
    agents: Path

    @property
    def place(self) -> str:
        """HOST/PATH, from where it pulls."""
        return f"{self.registry}/{PATH}"


def each_alone(topology: Topology) -> list[list[NodeSpec]]:
    """A machine for each node."""
    return [[node] for node in topology.nodes]


def two_machines(topology: Topology) -> list[list[NodeSpec]]:
    """One machine for platform and cloud, one for all vehicles."""
    vehicles = [node for node in topology.nodes if node.role == "vehicle"]
    return [[node for node in topology.nodes if node not in vehicles], vehicles]


@contextmanager
def made(
    name: str, binaries: Path, machines: Sequence[Sequence[NodeSpec]], built: Sequence[Image], folder: Path
) -> Iterator[ClusterOfOthers]:
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
            _believe(provider, registry.host, registry.authority)
            agents = folder / "agents.yaml"
            entries = [
                {"node": node.name, "role": one.role, "agent": one.agent, "capabilities": list(one.capabilities)}
                for node, own in zip(nodes, machines, strict=True)
                for one in own
            ]
            trial = {"trial": True} if len(entries) > len(nodes) else {}
            agents.write_text(yaml.safe_dump({**trial, "agents": entries}), encoding="utf-8")
            yield ClusterOfOthers(provider, registry.host, registry.authority, agents)
    finally:
        provider.down()


def _machine(name: str, nodes: Sequence[NodeSpec]) -> NodeSpec:
    """A machine as large as these nodes of a scenario, but not larger than this one, with the volumes that the last
    one's role has."""
    cpu, memory = sum(one.cpu_millicores for one in nodes), sum(one.memory_bytes for one in nodes)
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


def _believe(provider: Embedded, host: str, authority: Path) -> None:
    """Tell every Node's containerd who signs for the registry, and that it has the images of another name, too: what an
    administrator writes once."""
    text = authority.read_text(encoding="ascii")
    for name, path in ((host, ""), (BUILT_AS, f"/v2/{PATH.rpartition('/')[0]}")):
        place = provider.folders.hosts / pulling.host_folder(name)
        place.mkdir(parents=True, exist_ok=True)
        (place / "ca.crt").write_text(text, encoding="ascii")
        lines = [f'[host."https://{host}{path}"]', 'capabilities = ["pull", "resolve"]', 'ca = "ca.crt"']
        lines += ["override_path = true"] if path else []
        (place / "hosts.toml").write_text("\n".join([*lines, ""]), encoding="utf-8")
