"""The Secret with the gate's key, and the ConfigMaps with public keys, through the API server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol
from urllib.parse import quote

from robotkube.foundation.kubernetes.adapters.http_client import config_map_path

KEY_FILE = "key.pem"
LABELS: Mapping[str, str] = {
    "app.kubernetes.io/part-of": "robotkube",
    "app.kubernetes.io/component": "gate-key",
    "app.kubernetes.io/managed-by": "robotkube-gate-key",
}


class WritingApi(Protocol):
    """The calls needed of an API server; `foundation.kubernetes.adapters.http_client.ApiServer` offers them."""

    def get(self, path: str) -> dict[str, Any] | None: ...

    def create(self, path: str, body: Mapping[str, Any]) -> bool: ...

    def patch(self, path: str, body: Mapping[str, Any]) -> bool: ...


class KubernetesGateKey:
    """The port GateKeyObjects: the Secret `<namespace>/<name>`, ConfigMaps `public_keys` in `namespaces`. It reads no
    Secret: whether there is one, the API server says to who would make it."""

    def __init__(self, api: WritingApi, namespace: str, name: str, public_keys: str, namespaces: Sequence[str]) -> None:
        self._api = api
        self._secrets = f"/api/v1/namespaces/{quote(namespace)}/secrets"
        self._name = name
        self._public_keys = public_keys
        self._namespaces = tuple(namespaces)

    def has_key(self) -> bool:
        """Return whether making the Secret would meet one of that name: it is made as a trial, of which nothing
        stays."""
        return not self._api.create(f"{self._secrets}?dryRun=All", self._secret({}))

    def public_keys(self) -> Mapping[str, Mapping[str, str]]:
        """Namespace -> the public keys of its ConfigMap by file name."""
        read = {place: self._api.get(config_map_path(place, self._public_keys)) for place in self._namespaces}
        return {place: dict((document or {}).get("data") or {}) for place, document in read.items()}

    def publish(self, namespace: str, keys: Mapping[str, str]) -> None:
        """Add public keys to the namespace's ConfigMap, which is made when there is none."""
        body = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": self._metadata(self._public_keys)}
        if not self._api.create(config_map_path(namespace), {**body, "data": dict(keys)}):
            self._api.patch(config_map_path(namespace, self._public_keys), {"data": dict(keys)})

    def withdraw(self, namespace: str, name: str) -> None:
        """Take a public key out of the namespace's ConfigMap."""
        self._api.patch(config_map_path(namespace, self._public_keys), {"data": {name: None}})

    def keep(self, private_key: str) -> bool:
        """Make the Secret; False when there is one."""
        return self._api.create(self._secrets, self._secret({KEY_FILE: private_key}))

    def _secret(self, files: Mapping[str, str]) -> dict[str, Any]:
        body = {"apiVersion": "v1", "kind": "Secret", "metadata": self._metadata(self._name), "type": "Opaque"}
        return {**body, "stringData": dict(files)}

    @staticmethod
    def _metadata(name: str) -> dict[str, Any]:
        return {"name": name, "labels": dict(LABELS)}
