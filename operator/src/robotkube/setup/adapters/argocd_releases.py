"""The ApplicationSet and the Argo CD Applications of the platform, through the API server."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol
from urllib.parse import quote

GROUP = "argoproj.io"
VERSION = "v1alpha1"
PAGE_SIZE = 500
PAGES_MAX = 100


class Api(Protocol):
    """The two calls needed of an API server; `foundation.kubernetes.adapters.http_client.ApiServer` offers them."""

    def get(self, path: str) -> dict[str, Any] | None: ...

    def delete(self, path: str) -> bool: ...


class KubernetesInstalledReleases:
    """The port InstalledReleases: ApplicationSet `application_set`, Applications of AppProject `project`."""

    def __init__(self, api: Api, namespace: str, project: str, application_set: str) -> None:
        self._api = api
        self._project = project
        base = f"/apis/{GROUP}/{VERSION}/namespaces/{quote(namespace)}"
        self._set = f"{base}/applicationsets/{quote(application_set)}"
        self._applications = f"{base}/applications"

    def withdraw(self) -> bool:
        """Delete the ApplicationSet; its Applications follow by their owner references."""
        return self._api.delete(self._set)

    def remaining(self) -> Sequence[str]:
        """Names of the project's Applications, sorted; none when Argo CD's definitions are gone."""
        names: list[str] = []
        token = ""
        for _ in range(PAGES_MAX):
            page = self._api.get(f"{self._applications}?limit={PAGE_SIZE}&continue={token}") or {}
            names += [item["metadata"]["name"] for item in page.get("items", []) if self._ours(item)]
            token = page.get("metadata", {}).get("continue", "")
            if not token:
                break
        return sorted(names)

    def _ours(self, application: dict[str, Any]) -> bool:
        return bool(application.get("spec", {}).get("project") == self._project)
