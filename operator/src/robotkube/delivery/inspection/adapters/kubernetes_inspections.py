"""Inspections of one namespace, by the API server."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlencode

from robotkube.delivery.inspection.core.statuses import manifest
from robotkube.delivery.inspection.core.strangers import API_VERSION, GROUP, KIND, PLURAL, VERSION, Look, Stranger
from robotkube.delivery.inspection.ports import NotInstalledError
from robotkube.errors import UnavailableError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, custom_path, event_path
from robotkube.writes import writes

EVENT_NOTE_BYTES_MAX = 1024
APPLY = "application/apply-patch+yaml"
NOT_FOUND, CONFLICT = 404, 409


class KubernetesInspections:
    """The port Inspections in `namespace`, written in the name of `controller` (a process of ours, `inspector`)."""

    def __init__(self, api: ApiServer, namespace: str, controller: str, now: Callable[[], float]) -> None:
        self._api = api
        self._namespace = namespace
        self._controller = controller
        self._now = now
        self._uids: dict[str, str] = {}

    def names(self) -> tuple[str, ...]:
        """Names of all Inspections."""
        answer = self._api.get(self._path()) or {}
        return tuple(sorted(str(item["metadata"]["name"]) for item in answer.get("items") or ()))

    def standing(self, prefix: str) -> Mapping[str, Mapping[str, Any]]:
        """The statuses of those whose names begin with `prefix`."""
        answer = self._api.get(self._path()) or {}
        named = {str(item["metadata"]["name"]): item for item in answer.get("items") or ()}
        return {name: dict(item.get("status") or {}) for name, item in named.items() if name.startswith(prefix)}

    def status(self, name: str) -> Mapping[str, Any] | None:
        """The status as it stands."""
        item = self._api.get(self._path(name))
        if item is None:
            return None
        self._uids[name] = str(item["metadata"].get("uid", ""))
        return dict(item.get("status") or {})

    @writes("status")
    def write(self, look: Look, status: Mapping[str, Any]) -> Mapping[str, Any]:
        """Replace the status, but for conditions of others: by server-side apply, in the name of the controller. The
        Inspection is made when it is missing."""
        query = urlencode({"fieldManager": f"robotkube-{self._controller}", "force": "true"})
        path = f"{self._path(look.name)}/status?{query}"
        body = {**manifest(look, self._namespace), "status": status}
        code, answer = self._api.request("PATCH", path, body, APPLY)
        if code == NOT_FOUND:
            self._create(look)
            code, answer = self._api.request("PATCH", path, body, APPLY)
            self._uids.pop(look.name, None)
        if code in (NOT_FOUND, CONFLICT):
            raise UnavailableError(f"PATCH {path}: {code} {answer.get('message', '')}")
        return dict(answer.get("status") or {})

    def _create(self, look: Look) -> None:
        """Make an Inspection without a status; one that is there already is as good."""
        code, answer = self._api.request("POST", self._path(), manifest(look, self._namespace))
        if code == NOT_FOUND:
            raise NotInstalledError(f"POST {self._path()}: {answer.get('message') or 'not found'}")

    @writes("status")
    def remove(self, name: str) -> None:
        """Delete an Inspection."""
        self._api.delete(self._path(name))
        self._uids.pop(name, None)

    @writes("event")
    def report(self, look: Look, reason: str, stranger: Stranger) -> None:
        """Write an Event on the Inspection: Normal for one that went, else Warning. Its name is made of what it says
        and of the second: of two in one second the other is there already."""
        if look.name not in self._uids:
            self.status(look.name)
        moment = datetime.fromtimestamp(self._now(), UTC)
        place = (self._namespace, self._controller)
        event = inspection_event(look, self._uids.get(look.name, ""), reason, stranger, place, moment)
        self._api.create(event_path(self._namespace), event)

    def _path(self, name: str = "") -> str:
        return custom_path(GROUP, VERSION, self._namespace, PLURAL, name)


def inspection_event(
    look: Look, uid: str, reason: str, stranger: Stranger, place: tuple[str, str], at: datetime
) -> dict[str, Any]:
    """The Event (events.k8s.io/v1) on a look's Inspection; `place` is its namespace and the process that writes."""
    namespace, controller = place
    regarding = {"apiVersion": API_VERSION, "kind": KIND, "namespace": namespace, "name": look.name, "uid": uid}
    gone = reason != stranger.reason
    text = (
        f"{stranger} is gone, or is again what main says; it was there as {stranger.reason}"
        if gone
        else stranger.message
    )
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
