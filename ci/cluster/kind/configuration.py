"""A cluster as kind is told of it: pure, from a scenario's nodes.

kind calls its containers, and so the Nodes, `<cluster>-control-plane`, `<cluster>-worker`, `<cluster>-worker2` and so
on. No robot runs beside the control plane: each node of a scenario is a worker with the labels of its agent, or several
of them share one, in trial mode.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import yaml

from ci.cluster_contract import sharing
from ci.cluster_contract.topology import NodeSpec, Topology
from ci.errors import InputError

CLUSTER = "robotkube"
WORKERS = "KIND_WORKERS"
TOGETHER = ("platform", "cloud")  # roles that share the first worker
# Neither the ranges of the embedded cluster nor kind's own, of which one is the same.
PODS, SERVICES = "10.72.0.0/16", "10.73.0.0/16"
# Kubernetes since 1.35 refuses the first version of control groups, unless it is told.
VERSION_1 = "apiVersion: kubelet.config.k8s.io/v1beta1\nkind: KubeletConfiguration\nfailCgroupV1: false\n"


def configuration(workers: Sequence[Sequence[NodeSpec]], cgroups_of_version_1: bool) -> str:
    """The file that `kind create cluster` reads; `workers`: the scenario's nodes that each of them stands for."""
    document: dict[str, Any] = {
        "kind": "Cluster",
        "apiVersion": "kind.x-k8s.io/v1alpha4",
        "name": CLUSTER,
        "networking": {"podSubnet": PODS, "serviceSubnet": SERVICES},
        "nodes": [{"role": "control-plane"}, *map(_worker, workers)],
    }
    if cgroups_of_version_1:
        document["kubeadmConfigPatches"] = [VERSION_1]
    return yaml.safe_dump(document, sort_keys=False)


def key(configured: str, node_image: str) -> str:
    """What two clusters that are the same have in common."""
    return hashlib.sha256(f"{node_image}\n{configured}".encode()).hexdigest()


def shared_out(topology: Topology, wanted: str) -> list[list[NodeSpec]]:
    """The nodes of a scenario by worker: one each, unless fewer workers are `wanted`. Then platform and cloud share the
    first, and all others the rest, in their order. InputError where that cannot be."""
    if not wanted:
        return [[node] for node in topology.nodes]
    together = [node for node in topology.nodes if node.role in TOGETHER]
    others = [node for node in topology.nodes if node.role not in TOGETHER]
    most = bool(together) + len(others)
    if not wanted.isdecimal() or not 1 <= int(wanted) <= most:
        raise InputError(
            f"{WORKERS}={wanted}: must be a whole number from 1 to {most} for these {len(topology.nodes)} nodes; leave "
            "it out for a worker each"
        )
    rest = int(wanted) - bool(together)
    if not rest:
        return [list(topology.nodes)]
    bounds = [len(others) * number // rest for number in range(rest + 1)]
    shares = [others[begin:end] for begin, end in pairwise(bounds)]
    return [*([together] if together else []), *shares]


def _worker(nodes: Sequence[NodeSpec]) -> dict[str, Any]:
    return {"role": "worker", "labels": sharing.labels(nodes)}
