"""Kubelets over HTTPS, by the account's token: their lists of pods, and nothing else.

A kubelet asks the API server whether the account may `get nodes/pods` (fine-grained authorization, Kubernetes 1.33 and
later; before that the same paths needed `nodes/proxy`, which allows to run commands in containers).
"""

from __future__ import annotations

import http.client
import ssl
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robotkube.delivery.inspection.core.kubelet_pods import read_pods, read_runtime_pods
from robotkube.delivery.inspection.ports import NodeAddress, NodeReading
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.http_client import ACCOUNT_FOLDER, ApiServer

TIMEOUT_SECONDS = 2.0
ANSWER_BYTES_MAX = 16 * 1024 * 1024
PORT = 10250
PODS, RUNNING = "/pods", "/runningpods/"
CONTAINERD = "containerd://"
NODES_PATH = "/api/v1/nodes?resourceVersion=0"
RIGHT = "let the account get nodes/pods, and have the kubelet ask the API server (authentication and authorization)"


class Kubelets:
    """The port Nodes. Certificates of kubelets are checked by `authority` (None: they are not checked: who is in the
    way between here and there can answer for them, and read the token)."""

    def __init__(
        self,
        api: ApiServer,
        authority: Path | None = ACCOUNT_FOLDER / "ca.crt",
        token_file: Path = ACCOUNT_FOLDER / "token",
    ) -> None:
        self._api = api
        self._token_file = token_file
        self._context = ssl.create_default_context(cafile=authority) if authority else _unchecked()
        self._connections: dict[str, http.client.HTTPSConnection] = {}
        self._lock = threading.Lock()

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
        with self._lock:
            kept = list(self._connections.values())
            self._connections.clear()
        for connection in kept:
            connection.close()

    def _get(self, node: NodeAddress, path: str) -> Mapping[str, Any]:
        what = f"kubelet of node {node.name} ({node.host}:{node.port}), GET {path}"
        try:
            status, data = self._exchange(node, path)
        except ssl.SSLCertVerificationError as error:
            fix = (
                "have kubelets' certificates signed by the cluster (serverTLSBootstrap), or set kubelets.verify: false"
            )
            raise InputError(f"{what}: its certificate is not trusted: {error.verify_message}; {fix}") from error
        except (OSError, http.client.HTTPException) as error:
            raise UnavailableError(f"{what}: {error or type(error).__name__}") from error
        if status in (401, 403):
            raise InputError(f"{what}: refused ({status}); {RIGHT}")
        if status != 200:
            raise UnavailableError(f"{what}: {status} {data[:200].decode(errors='replace').strip()}")
        return _document(data, what)

    def _exchange(self, node: NodeAddress, path: str) -> tuple[int, bytes]:
        """Ask on the kept connection; when the kubelet closed that meanwhile, once more on a new one."""
        key = f"{node.host}:{node.port}"
        with self._lock:
            kept = self._connections.pop(key, None)
        if kept is not None:
            try:
                return self._ask(kept, key, path)
            except (OSError, http.client.HTTPException):
                kept.close()
        made = http.client.HTTPSConnection(node.host, node.port, timeout=TIMEOUT_SECONDS, context=self._context)
        try:
            return self._ask(made, key, path)
        except (OSError, http.client.HTTPException):
            made.close()
            raise

    def _ask(self, connection: http.client.HTTPSConnection, key: str, path: str) -> tuple[int, bytes]:
        token = self._token_file.read_text(encoding="utf-8").strip()
        connection.request("GET", path, headers={"Authorization": f"Bearer {token}"})
        response = connection.getresponse()
        data = response.read(ANSWER_BYTES_MAX)
        if response.isclosed():
            with self._lock:
                self._connections[key] = connection
        else:
            connection.close()
        return response.status, data


def _unchecked() -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _document(data: bytes, what: str) -> Mapping[str, Any]:
    try:
        document = read_json_shortened(data)
    except ValueError as error:
        raise UnavailableError(f"{what}: no JSON of at most {ANSWER_BYTES_MAX} bytes: {error}") from error
    if not isinstance(document, dict):
        raise UnavailableError(f"{what}: no list of pods")
    return document


def _address(item: Mapping[str, Any]) -> NodeAddress:
    status = item.get("status") or {}
    addresses = {entry["type"]: entry["address"] for entry in reversed(status.get("addresses") or ())}
    port = ((status.get("daemonEndpoints") or {}).get("kubeletEndpoint") or {}).get("Port") or PORT
    runtime = str((status.get("nodeInfo") or {}).get("containerRuntimeVersion", ""))
    host = str(addresses.get("InternalIP", ""))
    return NodeAddress(str(item["metadata"]["name"]), host, int(port), runtime.startswith(CONTAINERD))
