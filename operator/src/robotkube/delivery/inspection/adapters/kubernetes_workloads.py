"""Workloads of namespaces, by the API server: from what it holds in memory, so that asking often costs little."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from robotkube.delivery.inspection.core.permitted import CHARTS_KIND, SETTINGS_KIND
from robotkube.errors import InputError
from robotkube.foundation.kubernetes.adapters.http_client import JSON, METADATA_ALONE, ApiServer

PATHS: Mapping[str, tuple[str, str]] = {
    CHARTS_KIND: ("/apis/apps/v1", "deployments"),
    "ReplicaSet": ("/apis/apps/v1", "replicasets"),
    "StatefulSet": ("/apis/apps/v1", "statefulsets"),
    "DaemonSet": ("/apis/apps/v1", "daemonsets"),
    "Job": ("/apis/batch/v1", "jobs"),
    "CronJob": ("/apis/batch/v1", "cronjobs"),
    "ReplicationController": ("/api/v1", "replicationcontrollers"),
    "PodTemplate": ("/api/v1", "podtemplates"),
    SETTINGS_KIND: ("/api/v1", "configmaps"),
}
OTHER_KINDS = tuple(kind for kind in PATHS if kind not in (CHARTS_KIND, SETTINGS_KIND))


class KubernetesWorkloads:
    """The port Workloads."""

    def __init__(self, api: ApiServer) -> None:
        self._api = api

    @property
    def kinds(self) -> Sequence[str]:
        """Kinds besides those of releases."""
        return OTHER_KINDS

    def read(self, namespace: str, kind: str) -> Sequence[Mapping[str, Any]]:
        """The workloads of a kind in a namespace; of the further kinds only the metadata, which is all that is looked
        at."""
        group, plural = PATHS[kind]
        path = f"{group}/namespaces/{quote(namespace)}/{plural}"
        answer = self._api.get(f"{path}?resourceVersion=0", METADATA_ALONE if kind in OTHER_KINDS else JSON)
        if answer is None:
            raise InputError(f"{path}: the API server does not know this kind")
        return list(answer.get("items") or ())
