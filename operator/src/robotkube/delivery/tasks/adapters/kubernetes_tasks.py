"""Port TaskWriter: TaskDescriptions written at the API server, which refuses keys that its schema does not know.

`call` is that of the API client, bound to an account: it gives the open answer of one request, and raises KeyError
where there is no such object, InputError where the server refuses, UnavailableError where it does not answer or the
fault passes (with the server's own error, and its status, as cause).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol
from urllib.parse import quote

from robotkube.delivery.tasks.core.task_description import GROUP, PLURAL, VERSION
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.writes import writes

CONFLICT = 409
JSON = "application/json"
STRICT = (("fieldValidation", "Strict"),)
DRY_RUN = (("dryRun", "All"),)

Object = Mapping[str, Any]
Query = Sequence[tuple[str, str]]


class _ApiCall(Protocol):
    """One request to the API server, and its open answer."""

    def __call__(
        self, method: str, path: str, query: Query = (), *, body: Any = None, content_type: str = JSON
    ) -> Any: ...


class KubernetesTasks:
    """The port TaskWriter at the API server. With `dry_run` the server checks each write, and changes nothing."""

    def __init__(self, call: _ApiCall, dry_run: bool = False) -> None:
        self._call = call
        self._query = (*STRICT, *(DRY_RUN if dry_run else ()))

    def find(self, namespace: str, name: str) -> Object | None:
        """Read one task, as the port says."""
        try:
            task: Object = read_json_shortened(self._call("GET", task_path(namespace, name)).data)
        except KeyError:
            return None
        return task

    @writes("task")
    def create(self, document: Object) -> bool:
        """Make a task, as the port says."""
        namespace = document["metadata"]["namespace"]
        try:
            self._send("POST", task_path(namespace), document)
        except UnavailableError as error:
            if getattr(error.__cause__, "status", None) == CONFLICT:
                return False
            raise
        except KeyError as error:
            raise InputError(f"there is no namespace {namespace}, or the platform is not installed") from error
        return True

    @writes("task")
    def patch_spec(self, namespace: str, name: str, spec: Object) -> bool:
        """Replace a task's spec, as the port says."""
        return self._patch(namespace, name, [{"op": "replace", "path": "/spec", "value": spec}], "json-patch")

    @writes("task")
    def annotate(self, namespace: str, name: str, annotations: Mapping[str, str]) -> bool:
        """Set annotations of a task, as the port says."""
        return self._patch(namespace, name, {"metadata": {"annotations": dict(annotations)}}, "merge-patch")

    @writes("task")
    def delete(self, namespace: str, name: str) -> bool:
        """Delete a task, as the port says."""
        try:
            self._send("DELETE", task_path(namespace, name))
        except KeyError:
            return False
        return True

    def _patch(self, namespace: str, name: str, body: Any, form: str) -> bool:
        try:
            self._send("PATCH", task_path(namespace, name), body, f"application/{form}+json")
        except KeyError:
            return False
        return True

    def _send(self, method: str, path: str, body: Any = None, content_type: str = JSON) -> None:
        """Send a request whose answer says nothing more; read to its end, it leaves the connection to the next one."""
        self._call(method, path, self._query, body=body, content_type=content_type).read()


def task_path(namespace: str, name: str = "") -> str:
    """Path of a task, or of the namespace's list."""
    base = f"/apis/{GROUP}/{VERSION}/namespaces/{quote(namespace)}/{PLURAL}"
    return f"{base}/{quote(name)}" if name else base
