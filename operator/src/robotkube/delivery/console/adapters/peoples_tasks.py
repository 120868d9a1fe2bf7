"""TaskDescriptions at the API server in the name of people.

The console's account may impersonate one user without rights of his own, and listed groups: a request has what its
group has, and nothing of what the console's account has besides. The person's own name is an extra value, which gives
no right and stands in the API server's audit log.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import quote

from kubernetes import client

from robotkube.delivery.console.core.asking import USER
from robotkube.delivery.console.core.signing_in import Person
from robotkube.delivery.tasks.adapters.kubernetes_tasks import KubernetesTasks
from robotkube.errors import InputError, RefusalError
from robotkube.foundation.kubernetes.adapters.client import call

PERSON = "Impersonate-Extra-Robotkube.io%2fperson"
FORBIDDEN = 403
HOW = "Who runs the platform lists groups and their namespaces in console.signIn.writers."


class ImpersonatedTasks:
    """The port PeoplesTasks at the API server."""

    def __init__(self, api: client.ApiClient) -> None:
        self._api = api

    def submit(self, person: Person, group: str, task: Mapping[str, Any]) -> bool:
        """See the port."""
        return _translated(lambda: self._writer(person, group).create(task))

    def withdraw(self, person: Person, group: str, namespace: str, name: str) -> bool:
        """See the port."""
        return _translated(lambda: self._writer(person, group).delete(namespace, name))

    def _writer(self, person: Person, group: str) -> KubernetesTasks:
        headers = {"Impersonate-User": USER, "Impersonate-Group": group, PERSON: quote(person.name)}
        return KubernetesTasks(functools.partial(call, self._api, headers=headers))


def _translated(write: Callable[[], bool]) -> bool:
    try:
        return write()
    except InputError as error:
        if getattr(error.__cause__, "status", None) == FORBIDDEN:
            raise RefusalError("Forbidden", f"{error}. {HOW}") from error
        raise
