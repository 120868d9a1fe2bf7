"""The task of an installation test, through the API server: made, read and deleted by its own name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.delivery.tasks.core.mqtt_messages import own_event
from robotkube.delivery.tasks.core.task_description import GROUP, PLURAL, VERSION
from robotkube.errors import InputError
from robotkube.foundation.kubernetes.adapters.http_client import custom_path

REQUESTER = "installation-test"
LEASE_SECONDS = 120
"""The task of a test that was killed ends by itself after that."""


class TaskApi(Protocol):
    """The calls needed of an API server; `foundation.kubernetes.adapters.http_client.ApiServer` offers them."""

    def get(self, path: str) -> dict[str, Any] | None: ...

    def create(self, path: str, body: Mapping[str, Any]) -> bool: ...

    def delete(self, path: str) -> bool: ...


@dataclass(frozen=True)
class KubernetesTask:
    """The port AskedTask: the task `name` in `namespace`, for `application` with `parameters`, asked for at `now`."""

    api: TaskApi
    namespace: str
    name: str
    application: str
    parameters: Mapping[str, Any]
    now: str

    def ask(self) -> None:
        """Make it."""
        if not self.api.create(custom_path(GROUP, VERSION, self.namespace, PLURAL), self._document()):
            raise InputError(f"there is a task {self.namespace}/{self.name} already; start the test again")

    def read(self) -> Mapping[str, Any] | None:
        """The task as it is now."""
        return self.api.get(self._path)

    def withdraw(self) -> None:
        """Delete it."""
        self.api.delete(self._path)

    @property
    def _path(self) -> str:
        return custom_path(GROUP, VERSION, self.namespace, PLURAL, self.name)

    def _document(self) -> dict[str, Any]:
        spec = {
            "requester": REQUESTER,
            "event": own_event(self.namespace, self.name, self.now),
            "reason": "helm test: one recording, and away again",
            "application": self.application,
            "parameters": dict(self.parameters),
            "lease": {"seconds": LEASE_SECONDS},
        }
        metadata = {"namespace": self.namespace, "name": self.name}
        return {"apiVersion": f"{GROUP}/{VERSION}", "kind": "TaskDescription", "metadata": metadata, "spec": spec}
