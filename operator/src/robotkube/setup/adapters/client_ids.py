"""ConfigMaps from which processes read by which client people sign in, through the API server."""

from __future__ import annotations

import json

from kubernetes import client

from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.client import call, send
from robotkube.foundation.kubernetes.adapters.http_client import config_map_path

KEY = "client_id"
MERGE_PATCH = "application/merge-patch+json"


class ConfigMapClientIds:
    """The port ClientIds. The ConfigMaps are made by the chart, without a key: this account may read and change them,
    and make none."""

    def __init__(self, api: client.ApiClient) -> None:
        self._api = api

    def publish(self, namespace: str, config_map: str, client_id: str) -> bool:
        """Set the key `client_id`, when it has another value."""
        path = config_map_path(namespace, config_map)
        try:
            present = json.loads(call(self._api, "GET", path).read()).get("data") or {}
            if present.get(KEY) == client_id:
                return False
            send(self._api, "PATCH", path, {"data": {KEY: client_id}}, MERGE_PATCH)
        except KeyError as error:
            raise UnavailableError(f"ConfigMap {namespace}/{config_map}: not there; the chart makes it") from error
        return True
