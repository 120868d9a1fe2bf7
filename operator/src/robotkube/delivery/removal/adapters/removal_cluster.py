"""The cluster by the API server, as the remover's account may use it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from urllib.parse import quote, urlencode

from robotkube.delivery.inspection.core.strangers import API_VERSION, GROUP, KIND, PLURAL, VERSION
from robotkube.errors import InputError
from robotkube.foundation.documents.core.times import time_text
from robotkube.foundation.kubernetes.adapters.http_client import (
    EVENT_NOTE_BYTES_MAX,
    ApiServer,
    custom_path,
    event_path,
)
from robotkube.writes import writes

NAME = "remover"
APPLY, JSON_PATCH = "application/apply-patch+yaml", "application/json-patch+json"
INSPECTIONS_MAX = 5000
GONE, CONFLICT = 404, 409

Object = Mapping[str, Any]


class KubernetesRemoval:
    """The port RemovalCluster; Inspections stand in `namespace`. `now_ns` is the wall clock."""

    def __init__(self, api: ApiServer, namespace: str, now_ns: Callable[[], int]) -> None:
        self._api = api
        self._namespace = namespace
        self._now_ns = now_ns
        self._path = custom_path(GROUP, VERSION, namespace, PLURAL)

    def inspections(self) -> Sequence[Object]:
        """All Inspections."""
        answer = self._api.get(f"{self._path}?limit={INSPECTIONS_MAX}")
        if answer is None:
            raise InputError("the API server has no Inspections; install the platform's chart, which defines them")
        return list(answer.get("items") or ())

    def pod(self, namespace: str, name: str) -> Object | None:
        """A pod."""
        return self._api.get(_pod_path(namespace, name))

    def deployment(self, namespace: str, name: str) -> Object | None:
        """A Deployment."""
        return self._api.get(_deployment_path(namespace, name))

    @writes("workload")
    def delete_pod(self, pod: Object, grace_seconds: int) -> bool:
        """Delete it, when both its UID and its version are those that were read."""
        metadata = pod["metadata"]
        preconditions = {"uid": metadata["uid"], "resourceVersion": metadata["resourceVersion"]}
        body = {
            "apiVersion": "v1",
            "kind": "DeleteOptions",
            "gracePeriodSeconds": grace_seconds,
            "preconditions": preconditions,
        }
        path = _pod_path(metadata["namespace"], metadata["name"])
        return self._api.request("DELETE", path, body)[0] not in (GONE, CONFLICT)

    @writes("workload")
    def patch_deployment(self, deployment: Object, patch: Sequence[Object]) -> bool:
        """Apply the patch; the version in it is that which was read."""
        path = f"{_deployment_path(deployment['metadata']['namespace'], deployment['metadata']['name'])}"
        query = urlencode({"fieldManager": f"robotkube-{NAME}"})
        return self._api.request("PATCH", f"{path}?{query}", patch, JSON_PATCH)[0] not in (GONE, CONFLICT)

    @writes("status")
    def write_condition(self, inspection: str, condition: Object) -> None:
        """Apply the condition to the status: by server-side apply, which leaves those of others."""
        body = {
            "apiVersion": API_VERSION,
            "kind": KIND,
            "metadata": {"name": inspection, "namespace": self._namespace},
            "status": {"conditions": [condition]},
        }
        query = urlencode({"fieldManager": f"robotkube-{NAME}", "force": "true"})
        self._api.request("PATCH", f"{self._path}/{quote(inspection)}/status?{query}", body, APPLY)

    @writes("event")
    def report(self, inspection: str, uid: str, reason: str, text: str, warning: bool) -> None:
        """Write an Event on an Inspection. Its name is made of what it says: a second one is there already."""
        self._api.create(event_path(self._namespace), self._event(inspection, uid, reason, text, warning))

    def _event(self, inspection: str, uid: str, reason: str, text: str, warning: bool) -> dict[str, Any]:
        digest = hashlib.sha256("\0".join([uid, reason, text]).encode()).hexdigest()
        place = {"namespace": self._namespace, "name": inspection, "uid": uid}
        return {
            "apiVersion": "events.k8s.io/v1",
            "kind": "Event",
            "metadata": {"namespace": self._namespace, "name": f"{inspection[:200]}.{digest[:16]}"},
            "eventTime": time_text(self._now_ns()),
            "reportingController": f"{GROUP}/{NAME}",
            "reportingInstance": NAME,
            "action": "Removing",
            "reason": reason,
            "regarding": {"apiVersion": API_VERSION, "kind": KIND, **place},
            "note": text.encode()[:EVENT_NOTE_BYTES_MAX].decode(errors="ignore"),
            "type": "Warning" if warning else "Normal",
        }


def _pod_path(namespace: str, name: str) -> str:
    return f"/api/v1/namespaces/{quote(namespace)}/pods/{quote(name)}"


def _deployment_path(namespace: str, name: str) -> str:
    return f"/apis/apps/v1/namespaces/{quote(namespace)}/deployments/{quote(name)}"
