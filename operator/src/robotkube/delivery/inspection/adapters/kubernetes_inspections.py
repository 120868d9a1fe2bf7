"""Inspections of one namespace, by the API server."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from kubernetes import client

from robotkube.delivery.inspection.core.statuses import manifest
from robotkube.delivery.inspection.core.strangers import API_VERSION, GROUP, KIND, PLURAL, Look, Stranger
from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.kubernetes.adapters.client import CONFLICT, call, send
from robotkube.writes import writes

EVENT_NOTE_BYTES_MAX = 1024
MERGE = "application/merge-patch+json"


class KubernetesInspections:
    """The port Inspections in `namespace`, written in the name of `controller` (a process of ours, `inspector`)."""

    def __init__(self, api: client.ApiClient, namespace: str, controller: str, now: Callable[[], float]) -> None:
        self._api = api
        self._namespace = namespace
        self._controller = controller
        self._now = now
        self._path = f"/apis/{API_VERSION}/namespaces/{namespace}/{PLURAL}"
        self._uids: dict[str, str] = {}

    def names(self) -> tuple[str, ...]:
        """Names of all Inspections."""
        answer = read_json(call(self._api, "GET", self._path).data)
        return tuple(sorted(str(item["metadata"]["name"]) for item in answer.get("items") or ()))

    def status(self, name: str) -> Mapping[str, Any] | None:
        """The status as it stands."""
        try:
            item = read_json(call(self._api, "GET", f"{self._path}/{name}").data)
        except KeyError:
            return None
        self._uids[name] = str(item["metadata"].get("uid", ""))
        return dict(item.get("status") or {})

    @writes("status")
    def write(self, look: Look, status: Mapping[str, Any]) -> None:
        """Replace the status; the Inspection is made when it is missing."""
        try:
            self._patch(look.name, status)
        except KeyError:
            self._make(look)
            self._patch(look.name, status)

    @writes("status")
    def remove(self, name: str) -> None:
        """Delete an Inspection."""
        try:
            send(self._api, "DELETE", f"{self._path}/{name}", {})
        except KeyError:
            return

    @writes("event")
    def report(self, look: Look, reason: str, stranger: Stranger) -> None:
        """Write an Event on the Inspection: Normal for one that went, else Warning. Its name is made of what it says
        and of the second: of two in one second the other is there already."""
        event = inspection_event(look, self._uids.get(look.name, ""), reason, stranger, self._place(), self._moment())
        path = f"/apis/events.k8s.io/v1/namespaces/{self._namespace}/events"
        try:
            send(self._api, "POST", path, event)
        except UnavailableError as error:
            if not _is_conflict(error):
                raise

    def _patch(self, name: str, status: Mapping[str, Any]) -> None:
        path = f"{self._path}/{name}/status"
        item = read_json(call(self._api, "PATCH", path, body={"status": status}, content_type=MERGE).data)
        self._uids[name] = str(item["metadata"].get("uid", ""))

    def _make(self, look: Look) -> None:
        try:
            send(self._api, "POST", self._path, manifest(look, self._namespace))
        except UnavailableError as error:
            if not _is_conflict(error):
                raise

    def _place(self) -> tuple[str, str]:
        return self._namespace, self._controller

    def _moment(self) -> datetime:
        return datetime.fromtimestamp(self._now(), UTC)


def _is_conflict(error: UnavailableError) -> bool:
    return isinstance(error.__cause__, client.ApiException) and error.__cause__.status == CONFLICT


def inspection_event(
    look: Look, uid: str, reason: str, stranger: Stranger, place: tuple[str, str], at: datetime
) -> dict[str, Any]:
    """The Event (events.k8s.io/v1) on a look's Inspection; `place` is its namespace and the process that writes."""
    namespace, controller = place
    regarding = {"apiVersion": API_VERSION, "kind": KIND, "namespace": namespace, "name": look.name, "uid": uid}
    gone = reason != stranger.reason
    text = f"{stranger} is gone; it was there as {stranger.reason}" if gone else stranger.message
    words = "\0".join([uid, reason, *stranger.key, f"{at:%H:%M:%S}"])
    digest = hashlib.sha256(words.encode()).hexdigest()
    return {
        "apiVersion": "events.k8s.io/v1",
        "kind": "Event",
        "metadata": {"namespace": namespace, "name": f"{look.name[:200]}.{digest[:16]}"},
        "eventTime": at.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
        "reportingController": f"{GROUP}/{controller}",
        "reportingInstance": controller,
        "action": "Inspecting",
        "reason": reason,
        "regarding": regarding,
        "note": text.encode()[:EVENT_NOTE_BYTES_MAX].decode(errors="ignore"),
        "type": "Normal" if gone else "Warning",
    }
