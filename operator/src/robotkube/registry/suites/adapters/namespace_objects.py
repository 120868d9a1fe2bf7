"""The objects of a test namespace, through the API server.

Rights: those of the Role `suite-runner` in each namespace of the pool (docs/reference/suites.md). Secrets are made and
deleted by name, never read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Protocol
from urllib.parse import quote

import urllib3
from kubernetes.watch.watch import iter_resp_lines

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.registry.suites.core.namespace_contents import KINDS
from robotkube.registry.suites.ports.suites import Object

ANSWER_BYTES_MAX = 32 * 1024 * 1024
CHUNK_BYTES = 64 * 1024
EVENTS_LISTED_MAX = 50
MANAGER = "robotkube-suites"
PATHS = {kind: path for kind, (_, path) in KINDS.items()} | {
    "Pod": "/api/v1/namespaces/{}/pods",
    "Secret": "/api/v1/namespaces/{}/secrets",
    "Event": "/api/v1/namespaces/{}/events",
}


class ApiCall(Protocol):
    """One request to the API server; `kubernetes_api.call` with its client bound offers it. The open answer;
    UnavailableError, InputError or KeyError (no such object)."""

    def __call__(
        self,
        method: str,
        path: str,
        query: Sequence[tuple[str, str]] = (),
        body: Object | None = None,
        content_type: str = "application/json",
        seconds: float = 10.0,
    ) -> Any: ...


class KubernetesNamespaceObjects:
    """The port NamespaceObjects in one namespace."""

    def __init__(self, call: ApiCall, namespace: str) -> None:
        self._call = call
        self._namespace = namespace

    def _path(self, kind: str, name: str = "") -> str:
        base = PATHS[kind].format(quote(self._namespace))
        return f"{base}/{quote(name)}" if name else base

    def list(self, kind: str) -> tuple[Sequence[Object], str]:
        """The objects, and the position from which changes can be watched."""
        return self._list(kind, ())

    def _list(self, kind: str, query: Sequence[tuple[str, str]]) -> tuple[Sequence[Object], str]:
        answer = self._read("GET", self._path(kind), query)
        return answer.get("items") or [], str(answer["metadata"]["resourceVersion"])

    def get(self, kind: str, name: str) -> Object | None:
        """One object; None when it is not there."""
        try:
            return self._read("GET", self._path(kind, name))
        except KeyError:
            return None

    def create(self, kind: str, body: Object) -> None:
        """A new object."""
        self._read("POST", self._path(kind), body=body)

    def apply(self, body: Object) -> None:
        """Server-side apply: fields that are no longer in `body` go."""
        path = self._path(body["kind"], body["metadata"]["name"])
        query = [("fieldManager", MANAGER), ("force", "true")]
        self._read("PATCH", path, query, body, "application/apply-patch+yaml")

    def delete(self, kind: str, name: str, grace_seconds: int | None = None) -> None:
        """Deleted, or not there."""
        query = [("propagationPolicy", "Background")]
        if grace_seconds is not None:
            query.append(("gracePeriodSeconds", str(grace_seconds)))
        try:
            self._read("DELETE", self._path(kind, name), query)
        except KeyError:
            return

    def log(self, pod: str, container: str, bytes_max: int, lines_max: int = 0, previous: bool = False) -> str:
        """The end of a container's log; empty when there is none (yet)."""
        query = [("container", container)]
        query += [("tailLines", str(lines_max))] if lines_max else []
        query += [("previous", "true")] if previous else []
        try:
            answer = self._call("GET", f"{self._path('Pod', pod)}/log", query)
            return _tail(answer, bytes_max).decode("utf-8", "replace")
        except (KeyError, InputError):
            return ""

    def events(self, kind: str, name: str) -> Sequence[Object]:
        """The Events of an object, oldest first."""
        selector = f"involvedObject.kind={kind},involvedObject.name={name}"
        events, _ = self._list("Event", [("fieldSelector", selector), ("limit", str(EVENTS_LISTED_MAX))])
        return sorted(events, key=lambda item: str(item.get("lastTimestamp") or item.get("eventTime") or ""))

    def changes(self, kind: str, version: str, seconds: float) -> Iterator[tuple[str, Object]]:
        """Type and object of each change from `version` on, until the time is over or the server ends it."""
        query = [("watch", "true"), ("resourceVersion", version), ("timeoutSeconds", str(math.ceil(seconds)))]
        answer = self._call("GET", self._path(kind), query, seconds=seconds + 1)
        try:
            for line in iter_resp_lines(answer):
                event = read_json_shortened(line)
                if event["type"] == "ERROR":
                    return
                yield event["type"], event["object"]
        except urllib3.exceptions.HTTPError:
            return
        finally:
            answer.close()
            answer.release_conn()

    def _read(
        self,
        method: str,
        path: str,
        query: Sequence[tuple[str, str]] = (),
        body: Object | None = None,
        content_type: str = "application/json",
    ) -> dict[str, Any]:
        answer = self._call(method, path, query, body, content_type)
        try:
            data = answer.read(ANSWER_BYTES_MAX + 1)
        except urllib3.exceptions.HTTPError as error:
            raise UnavailableError(f"API server: {method} {path}: {error}") from error
        finally:
            answer.release_conn()
        if len(data) > ANSWER_BYTES_MAX:
            raise UnavailableError(f"API server: {method} {path}: answered more than {ANSWER_BYTES_MAX} bytes")
        document = read_json_shortened(data)
        return document if isinstance(document, dict) else {}


def _tail(answer: Any, bytes_max: int) -> bytes:
    """The last `bytes_max` of an answer, without keeping more."""
    kept = b""
    try:
        for chunk in answer.stream(CHUNK_BYTES):
            kept = (kept + chunk)[-bytes_max:]
    except urllib3.exceptions.HTTPError:
        return kept
    finally:
        answer.release_conn()
    return kept
