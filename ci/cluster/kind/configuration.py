"""A cluster as kind is told of it: pure, from a scenario's nodes.

kind calls its containers, and so the Nodes, `<cluster>-control-plane`, `<cluster>-worker`, `<cluster>-worker2` and so
on. No robot runs beside the control plane: each node of a scenario is a worker with the labels of its agent.
"""

from __future__ import annotations

import hashlib
from typing import Any

import yaml

from ci.cluster_contract.topology import NodeSpec, Topology

CLUSTER = "robotkube"
# Neither the ranges of the embedded cluster nor kind's own, of which one is the same.
PODS, SERVICES = "10.72.0.0/16", "10.73.0.0/16"
# Kubernetes since 1.35 refuses the first version of control groups, unless it is told.
VERSION_1 = "apiVersion: kubelet.config.k8s.io/v1beta1\nkind: KubeletConfiguration\nfailCgroupV1: false\n"


def configuration(topology: Topology, cgroups_of_version_1: bool) -> str:
    """The file that `kind create cluster` reads."""
    document: dict[str, Any] = {
        "kind": "Cluster",
        "apiVersion": "kind.x-k8s.io/v1alpha4",
        "name": CLUSTER,
        "networking": {"podSubnet": PODS, "serviceSubnet": SERVICES},
        "nodes": [{"role": "control-plane"}, *map(_worker, topology.nodes)],
    }
    if cgroups_of_version_1:
        document["kubeadmConfigPatches"] = [VERSION_1]
    return yaml.safe_dump(document, sort_keys=False)


def key(configured: str, node_image: str) -> str:
    """What two clusters that are the same have in common."""
    return hashlib.sha256(f"{node_image}\n{configured}".encode()).hexdigest()


def _worker(node: NodeSpec) -> dict[str, Any]:
    return {"role": "worker", "labels": dict(node.labels)}
