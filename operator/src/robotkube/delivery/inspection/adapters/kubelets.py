"""Kubelets' lists of pods, and nothing else, by the right to `get nodes/pods`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.delivery.inspection.core.kubelet_pods import read_pods, read_runtime_pods
from robotkube.delivery.inspection.ports import NodeAddress, NodeReading
from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer
from robotkube.foundation.kubernetes.adapters.kubelet_client import PORT, KubeletClient

PODS, RUNNING = "/pods", "/runningpods/"
CONTAINERD = "containerd://"
NODES_PATH = "/api/v1/nodes?resourceVersion=0"
RIGHT = "let the account get nodes/pods, and have the kubelet ask the API server (authentication and authorization)"


class Kubelets:
    """The port Nodes."""

    def __init__(self, api: ApiServer, client: KubeletClient) -> None:
        self._api = api
        self._client = client

    def addresses(self) -> Sequence[NodeAddress]:
        """All nodes, by name."""
        answer = self._api.get(NODES_PATH) or {}
        nodes = (_address(item) for item in answer.get("items") or ())
        return sorted((node for node in nodes if node.host), key=lambda node: node.name)

    def read(self, node: NodeAddress) -> NodeReading:
        """What the node's kubelet lists."""
        running = self._get(node, RUNNING)
        pods = self._get(node, PODS)
        try:
            return NodeReading(read_pods(pods, node.digests), read_runtime_pods(running))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise UnavailableError(
                f"kubelet of node {node.name}: what it lists is no list of pods: {error!r}"
            ) from error

    def close(self) -> None:
        """Give kept connections back; the next question makes a new one."""
        self._client.close()

    def _get(self, node: NodeAddress, path: str) -> Mapping[str, Any]:
        return self._client.get(f"kubelet of node {node.name}", node.host, node.port, path)


def _address(item: Mapping[str, Any]) -> NodeAddress:
    status = item.get("status") or {}
    addresses = {entry["type"]: entry["address"] for entry in reversed(status.get("addresses") or ())}
    port = ((status.get("daemonEndpoints") or {}).get("kubeletEndpoint") or {}).get("Port") or PORT
    runtime = str((status.get("nodeInfo") or {}).get("containerRuntimeVersion", ""))
    host = str(addresses.get("InternalIP", ""))
    return NodeAddress(str(item["metadata"]["name"]), host, int(port), runtime.startswith(CONTAINERD))
