"""A cluster by the program kind alone, whose owner follows kind's pages and knows nothing of this project: one control
plane and two workers, with a registry beside them that their containerd is told to believe
(https://kind.sigs.k8s.io/docs/user/local-registry, by certificates instead of in clear)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from ci import distribution, kind_cli
from ci.cluster.kind.configuration import VERSION_1
from ci.cluster_contract.topology import NodeSpec
from ci.kind_node_image import naming
from ci.machine import cgroups, preparing
from tests.stages.kind.docker_engine import DockerEngine
from tests.stages.platform.lent_cluster import LentCluster, believe, write_agents
from tests.stages.registry.distribution import open_to_all

NAME = "fleet"
WORKERS = (f"{NAME}-worker", f"{NAME}-worker2")
OF_ITS_OWN = ("kube-system", "local-path-storage")  # namespaces with pods that kind starts
NODES, GATEWAY = "10.78.0.0/24", "10.78.0.1"
PODS, SERVICES = "10.76.0.0/16", "10.77.0.0/16"
HOSTS = "/etc/containerd/certs.d"
CONTAINERD = f'[plugins."io.containerd.grpc.v1.cri".registry]\n  config_path = "{HOSTS}"\n'
NETWORK_SECONDS_MAX, CREATE_SECONDS_MAX, DELETE_SECONDS_MAX = 60, 400, 120


@contextmanager
def lent(engine: DockerEngine, machines: Sequence[Sequence[NodeSpec]]) -> Iterator[LentCluster]:
    """The cluster, each worker of which is to stand for these nodes of a scenario; it is deleted afterwards, and its
    registry has ended."""
    folder, hosts = engine.folder / "registry", engine.folder / "hosts"
    folder.mkdir()
    hosts.mkdir()
    network = ["docker", "network", "create", f"--subnet={NODES}", f"--gateway={GATEWAY}", "kind"]
    engine.run(*network, seconds=NETWORK_SECONDS_MAX)
    namespace = Path(f"/proc/{engine.first}/ns/net")
    with open_to_all(distribution.ensure() / "registry", folder, GATEWAY, namespace) as registry:
        believe(hosts, registry.host, registry.authority)
        kind = str(kind_cli.ensure())
        kubeconfig = engine.folder / "kubeconfig"
        words = ["--config=-", f"--kubeconfig={kubeconfig}", "--wait=120s", f"--image={naming.reference()}"]
        text = yaml.safe_dump(_configuration(hosts), sort_keys=False)
        engine.run(kind, "create", "cluster", *words, seconds=CREATE_SECONDS_MAX, text=text)
        agents = engine.folder / "agents.yaml"
        write_agents(agents, dict(zip(WORKERS, machines, strict=True)))
        program = str(preparing.tool_chain() / "kubectl")
        kubectl = ("nsenter", f"--net={namespace}", program, "--kubeconfig", str(kubeconfig))
        yield LentCluster(kubectl, kubeconfig, registry.host, registry.authority, agents, engine.attempt)
        engine.run(
            kind, "delete", "cluster", f"--name={NAME}", f"--kubeconfig={kubeconfig}", seconds=DELETE_SECONDS_MAX
        )


def _configuration(hosts: Path) -> dict[str, Any]:
    """The file for kind; `hosts` is the folder that each node's containerd asks who signs for a registry."""
    mounted = {"extraMounts": [{"hostPath": str(hosts), "containerPath": HOSTS, "readOnly": True}]}
    configuration: dict[str, Any] = {
        "kind": "Cluster",
        "apiVersion": "kind.x-k8s.io/v1alpha4",
        "name": NAME,
        "networking": {"podSubnet": PODS, "serviceSubnet": SERVICES},
        "containerdConfigPatches": [CONTAINERD],
        "nodes": [{"role": role, **mounted} for role in ("control-plane", *("worker" for _ in WORKERS))],
    }
    if not cgroups.unified():
        configuration["kubeadmConfigPatches"] = [VERSION_1]
    return configuration
