"""Policies, bindings and the list as objects of the API, written by an account that does only this.

Each object is replaced as a whole, so nothing that somebody adds stays. All belong to the account's ClusterRole
(ownerReferences): uninstalled, they go with it, and no agent's namespace stays locked. What somebody changes or deletes
is seen by watches, and written again.

An object that is not there is made by server-side apply, for which the API server asks whether this name may be created
(a POST has no name yet): so the account may make these objects and no others.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kubernetes.client import ApiClient

from robotkube.errors import UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.kubernetes.adapters.client import ResourceWatch, call
from robotkube.registry.admission.core.list_objects import WRITER, read_list
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.policies import API_POLICIES, LIST

POLICY, BINDING, CONFIG_MAP = "ValidatingAdmissionPolicy", "ValidatingAdmissionPolicyBinding", "ConfigMap"
API = "/apis/admissionregistration.k8s.io/v1"
COLLECTIONS = {POLICY: f"{API}/validatingadmissionpolicies", BINDING: f"{API}/validatingadmissionpolicybindings"}
ROLES = "/apis/rbac.authorization.k8s.io/v1/clusterroles"
APPLY = "application/apply-patch+yaml"
CONTENT = ("spec", "data", "binaryData", "immutable")
LIST_SECONDS_MAX = 2.0
METADATA = ("labels", "annotations", "ownerReferences")

Key = tuple[str, str]
"""Kind and name."""
Document = Mapping[str, Any]

log = logging.getLogger(__name__)


class PolicyObjects:
    """Port PolicyPlace by the API, for the platform's `namespace`. `notify` is called from other threads when somebody
    changed an object, after which `intact` says so. UnavailableError: the API server does not answer; InputError: it
    refuses."""

    def __init__(self, api: ApiClient, namespace: str, notify: Callable[[], None]) -> None:
        self._api = api
        self._notify = notify
        lists = f"/api/v1/namespaces/{namespace}/configmaps"
        self._collections = {**COLLECTIONS, CONFIG_MAP: lists}
        self._keys = ((CONFIG_MAP, LIST), *((kind, name) for kind in (BINDING, POLICY) for name in API_POLICIES))
        self._lock = threading.Lock()
        self._touched = set(self._keys)
        self._written: dict[Key, Document] = {}
        self._contents: dict[Key, str] = {}
        self.restored = 0  # objects that somebody else had changed or deleted
        self._watches = [
            self._watch(kind, path, f"metadata.name={LIST}" if kind == CONFIG_MAP else "")
            for kind, path in self._collections.items()
        ]

    def start(self) -> None:
        """Begin to watch, and wait for the first lists, so that no change comes before its watch; not for long, since
        writing does without them."""
        for watch in self._watches:
            watch.start()
        for watch in self._watches:
            watch.synced.wait(LIST_SECONDS_MAX)

    def stop(self) -> None:
        """End the watches."""
        for watch in self._watches:
            watch.stop()

    def complaints(self) -> list[str]:
        """A sentence per watch that does not run: what somebody changes is not seen then."""
        return [watch.complaint for watch in self._watches if watch.complaint]

    def intact(self) -> bool:
        """Return whether nothing was seen to be changed since it was written."""
        return not self._touched

    def write(self, documents: Sequence[Document]) -> bool:
        """Write what differs from the last time and what somebody touched, one after the other; remove policies that
        are not among `documents`. What fails is written with the next call."""
        owner = self._owner()
        with self._lock:
            touched, self._touched = self._touched, set()
        wanted = {(item["kind"], item["metadata"]["name"]): _owned(item, owner) for item in documents}
        try:
            due = [key for key in wanted if key in touched or self._written.get(key) != wanted[key]]
            gone = [key for key in self._keys if key not in wanted and (key in touched or key in self._written)]
            changed = [self._put(key, wanted[key]) for key in due] + [self._remove(key) for key in gone]
        except Exception:
            with self._lock:
                self._touched |= touched
            raise
        return any(changed)

    def read(self, kind: str, name: str) -> dict[str, Any] | None:
        """An object as it stands; None when it does not."""
        try:
            return _document(call(self._api, "GET", f"{self._collections[kind]}/{name}"))
        except KeyError:
            return None

    def _owner(self) -> list[dict[str, str]]:
        """The account's ClusterRole; nobody where it runs with other rights. Asked each time: it may be a new one."""
        try:
            role = _document(call(self._api, "GET", f"{ROLES}/{WRITER}"))
        except KeyError:
            return []
        group = "rbac.authorization.k8s.io/v1"
        return [{"apiVersion": group, "kind": "ClusterRole", "name": WRITER, "uid": role["metadata"]["uid"]}]

    def _put(self, key: Key, document: Document) -> bool:
        kind, name = key
        path = f"{self._collections[kind]}/{name}"
        stands = self.read(kind, name)
        if stands is None:
            query = [("fieldManager", WRITER), ("force", "true")]
            now = self._send("PATCH", path, query, document, APPLY)
        else:
            version = {"resourceVersion": stands["metadata"]["resourceVersion"]}
            body = {**document, "metadata": {**document["metadata"], **version}}
            now = self._send("PUT", path, [("fieldManager", WRITER)], body, "application/json")
        changed = stands is None or stands["metadata"]["resourceVersion"] != now["metadata"]["resourceVersion"]
        if changed and self._written.get(key) == document:
            self.restored += 1
            log.warning("admission object restored kind=%s name=%s", kind, name)
        self._written[key] = document
        with self._lock:
            self._contents[key] = _content(now)
        return changed

    def _send(
        self, method: str, path: str, query: Sequence[tuple[str, str]], body: Document, kind: str
    ) -> dict[str, Any]:
        try:
            return _document(call(self._api, method, path, query, body, kind))
        except KeyError as error:
            raise UnavailableError(
                f"API server: {method} {path}: there is no such place, or nothing there any more; admission needs "
                "Kubernetes 1.30 or newer"
            ) from error

    def _remove(self, key: Key) -> bool:
        kind, name = key
        try:
            call(self._api, "DELETE", f"{self._collections[kind]}/{name}").read()
            removed = True
        except KeyError:
            removed = False
        self._written.pop(key, None)
        return removed

    def _watch(self, kind: str, path: str, field: str) -> ResourceWatch:
        def reduce(item: Document) -> str | None:
            return _content(item) if (kind, item["metadata"]["name"]) in self._keys else None

        def changed(key: str, before: str | None, now: str | None) -> None:
            self._seen((kind, key.rpartition("/")[2]), now)

        return ResourceWatch(self._api, path, "", reduce, changed, field_selector=field)

    def _seen(self, key: Key, now: str | None) -> None:
        with self._lock:
            if now == self._contents.get(key):
                return
            self._touched.add(key)
        self._notify()


class ListMemory:
    """Port ListingMemory: the ConfigMap itself, which `place` writes."""

    def __init__(self, place: PolicyObjects) -> None:
        self._place = place

    def load(self) -> AllowedVersions:
        """The list in it; of one that is not there none."""
        stands = self._place.read(CONFIG_MAP, LIST)
        return read_list(stands) if stands else AllowedVersions()

    def save(self, listing: AllowedVersions) -> None:
        """Nothing: it stands there."""


def _owned(document: Document, owner: list[dict[str, str]]) -> Document:
    metadata = {**document["metadata"], **({"ownerReferences": owner} if owner else {})}
    return {**document, "metadata": metadata}


def _document(answer: Any) -> dict[str, Any]:
    document: dict[str, Any] = read_json(answer.data)
    return document


def _content(item: Document) -> str:
    """What of an object is ours to say, as text."""
    own = {key: item.get(key) for key in CONTENT if item.get(key)}
    metadata = {key: item["metadata"].get(key) for key in METADATA if item["metadata"].get(key)}
    return json.dumps([own, metadata], sort_keys=True)
