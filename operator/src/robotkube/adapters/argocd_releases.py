"""The ApplicationSet and the Argo CD Applications of the platform, through the API server."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robotkube.adapters.kubernetes_http import ApiServer, custom_path

GROUP, VERSION = "argoproj.io", "v1alpha1"
PAGE_SIZE, PAGES_MAX = 500, 100


class KubernetesInstalledReleases:
    """The port InstalledReleases: ApplicationSet `application_set`, Applications of AppProject `project`."""

    def __init__(self, api: ApiServer, namespace: str, project: str, application_set: str) -> None:
        self._api, self._project = api, project
        self._set = custom_path(GROUP, VERSION, namespace, "applicationsets", application_set)
        self._applications = custom_path(GROUP, VERSION, namespace, "applications")

    def withdraw(self) -> bool:
        """Delete the ApplicationSet; its Applications follow by their owner references."""
        return self._api.delete(self._set)

    def remaining(self) -> Sequence[str]:
        """Names of the project's Applications, sorted; none when Argo CD's definitions are gone."""
        names, token = [], ""
        for _ in range(PAGES_MAX):
            page = self._api.get(f"{self._applications}?limit={PAGE_SIZE}&continue={token}") or {}
            names += [item["metadata"]["name"] for item in page.get("items", []) if self._ours(item)]
            token = page.get("metadata", {}).get("continue", "")
            if not token:
                break
        return sorted(names)

    def _ours(self, application: dict[str, Any]) -> bool:
        return bool(application.get("spec", {}).get("project") == self._project)
