"""Objects a fresh cluster gets from its provider: rights of its processes, StorageClass, volumes made in advance."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from ci.cluster.api_server.client import Api
from ci.cluster.embedded.nodes.node_processes import Node
from ci.errors import SetUpError

STORAGE_CLASS = "local"
SUITE_NAMESPACES = 3  # namespaces in which charts are tried, each with a volume claim on the cloud's node
VOLUME_SIZE = "20Gi"
VOLUMES_PER_ROLE = {"platform": 6, "cloud": 4 + SUITE_NAMESPACES}
VOLUMES_OTHERWISE = 3
VOLUMES = "/api/v1/persistentvolumes"
RBAC = "/apis/rbac.authorization.k8s.io/v1"


def create(api: Api, nodes: tuple[Node, ...]) -> None:
    """Apply all objects and make the volumes' folders."""
    for path, manifest in [*_rights(), _storage_class()]:
        api.apply(path, manifest)
    for node in nodes:
        for name, folder in volumes(node):
            folder.mkdir(parents=True, exist_ok=True)
            api.apply(f"{VOLUMES}/{name}", persistent_volume(node, name, folder))


def volumes(node: Node) -> tuple[tuple[str, Path], ...]:
    """Names and folders of the node's volumes."""
    count = VOLUMES_PER_ROLE.get(node.spec.role, VOLUMES_OTHERWISE)
    return tuple((f"{node.name}-{number}", node.folders.volumes / node.name / str(number)) for number in range(count))


def persistent_volume(node: Node, name: str, folder: Path) -> dict[str, Any]:
    """A local volume that only this node's pods can use; kept when its volume claim goes."""
    here = {"key": "kubernetes.io/hostname", "operator": "In", "values": [node.name]}
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolume",
        "metadata": {"name": name, "labels": node.spec.labels},
        "spec": {
            "accessModes": ["ReadWriteOnce"],
            "capacity": {"storage": VOLUME_SIZE},
            "local": {"path": str(folder)},
            "nodeAffinity": {"required": {"nodeSelectorTerms": [{"matchExpressions": [here]}]}},
            "persistentVolumeReclaimPolicy": "Retain",
            "storageClassName": STORAGE_CLASS,
        },
    }


class ObjectReader(Protocol):
    """Reads of the API server."""

    def get(self, path: str) -> dict[str, Any]:
        """The object or list at `path`; SetUpError when it is not there."""


def volume_path(api: ObjectReader, namespace: str, volume_claim: str) -> Path:
    """The folder of the host behind a bound volume claim; raises SetUpError naming the claim's state otherwise."""
    bound = api.get(f"/api/v1/namespaces/{namespace}/persistentvolumeclaims/{volume_claim}")
    volume = bound["spec"].get("volumeName")
    if not volume:
        phase = bound.get("status", {}).get("phase", "unknown")
        raise SetUpError(
            f"volume claim {namespace}/{volume_claim} has no volume (phase {phase}): start a pod that uses it"
        )
    return Path(api.get(f"{VOLUMES}/{volume}")["spec"]["local"]["path"])


def _storage_class() -> tuple[str, dict[str, Any]]:
    manifest = {
        "apiVersion": "storage.k8s.io/v1",
        "kind": "StorageClass",
        "metadata": {
            "name": STORAGE_CLASS,
            "annotations": {"storageclass.kubernetes.io/is-default-class": "true"},
        },
        "provisioner": "kubernetes.io/no-provisioner",
        "volumeBindingMode": "WaitForFirstConsumer",
        "reclaimPolicy": "Retain",
    }
    return f"/apis/storage.k8s.io/v1/storageclasses/{STORAGE_CLASS}", manifest


def _rights() -> list[tuple[str, dict[str, Any]]]:
    """Of the name service, of the API server at the kubelets, and of kubelets to see volume claims and volumes.

    The node authorizer gives them those of their pods, but learns of a pod later than its kubelet may: that one then
    gives the pod up for 10 to 15 s. What a volume claim or a volume holds is no secret."""
    names = [
        {"apiGroups": [""], "resources": ["services", "namespaces"], "verbs": ["list", "watch"]},
        {"apiGroups": ["discovery.k8s.io"], "resources": ["endpointslices"], "verbs": ["list", "watch"]},
    ]
    volumes = [{"apiGroups": [""], "resources": ["persistentvolumeclaims", "persistentvolumes"], "verbs": ["get"]}]
    return [
        _role("robotkube:name-service", names),
        _binding("robotkube:name-service", "robotkube:name-service"),
        _binding("robotkube:kubelet-client", "system:kubelet-api-admin"),
        _role("robotkube:node-volumes", volumes),
        _binding("system:nodes", "robotkube:node-volumes", "Group"),
    ]


def _role(name: str, rules: list[dict[str, Any]]) -> tuple[str, dict[str, Any]]:
    manifest = {
        "apiVersion": "rbac.authorization.k8s.io/v1",
        "kind": "ClusterRole",
        "metadata": {"name": name},
        "rules": rules,
    }
    return f"{RBAC}/clusterroles/{name}", manifest


def _binding(subject: str, role: str, kind: str = "User") -> tuple[str, dict[str, Any]]:
    name = subject if kind == "User" else role
    manifest = {
        "apiVersion": "rbac.authorization.k8s.io/v1",
        "kind": "ClusterRoleBinding",
        "metadata": {"name": name},
        "roleRef": {"apiGroup": "rbac.authorization.k8s.io", "kind": "ClusterRole", "name": role},
        "subjects": [{"apiGroup": "rbac.authorization.k8s.io", "kind": kind, "name": subject}],
    }
    return f"{RBAC}/clusterrolebindings/{name}", manifest
