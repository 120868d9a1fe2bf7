"""The TaskDescriptions that a detector makes, renews and deletes over the API server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.errors import InputError, RefusalError
from robotkube.foundation.kubernetes.adapters.http_client import ApiServer, custom_path
from robotkube.foundation.runtime.loops.fencing import Fencing
from robotkube.robots.reactions.core.task_requests import renewal

TASKS = ("robotkube.io", "v1alpha1", "taskdescriptions")


class ApiTasks:
    """The TaskDescriptions of one namespace over the API server (port OwnTasks). While the process is fenced nothing is
    written: UnavailableError."""

    def __init__(self, api: ApiServer, namespace: str, fencing: Fencing) -> None:
        self._api = api
        self._namespace = namespace
        self._fencing = fencing

    def tasks(self) -> Sequence[Mapping[str, Any]]:
        """See the port."""
        task_list = self._api.get(self._path()) or {}
        return list(task_list.get("items", []))

    def create(self, task: Mapping[str, Any]) -> None:
        """Create the object; RefusalError carries the server's words."""
        self._fencing.check()
        try:
            self._api.create(self._path(), task)
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def renew(self, name: str, now: int) -> bool:
        """Renew the lease by a patch of the annotation."""
        self._fencing.check()
        try:
            return self._api.patch(self._path(name), renewal(now))
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def delete(self, name: str) -> None:
        """Delete the object."""
        self._fencing.check()
        try:
            self._api.delete(self._path(name))
        except InputError as error:
            raise RefusalError("Refused", str(error)) from error

    def _path(self, name: str = "") -> str:
        group, version, plural = TASKS
        return custom_path(group, version, self._namespace, plural, name)
