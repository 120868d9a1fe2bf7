"""Tasks that people ask for on the page: what they may ask, in which namespaces, and the TaskDescription of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.console.core.signing_in import Person
from robotkube.delivery.tasks.core.mqtt_messages import own_event
from robotkube.delivery.tasks.core.task_description import GROUP, VERSION
from robotkube.foundation.documents.core.patterns import NAME
from robotkube.foundation.documents.core.reader import Reader

GROUP_PREFIX = "robotkube:console:"
"""In front of a group of the provider's at the API server, so that it is none of the cluster's own."""
USER = "robotkube:console"
REQUESTER_CHARACTERS_MAX = 253
REASON_CHARACTERS_MAX = 200
PRIORITY_MAX = 1000

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Writers:
    """A group of the provider's whose members may ask for tasks in these namespaces."""

    group: str
    namespaces: frozenset[str]


def writable(person: Person, writers: Iterable[Writers]) -> tuple[str, ...]:
    """The namespaces in which somebody may ask for tasks."""
    return tuple(
        sorted({namespace for listed in writers if listed.group in person.groups for namespace in listed.namespaces})
    )


def group_for(person: Person, writers: Iterable[Writers], namespace: str) -> str:
    """The group, as the API server has it, by which somebody asks in a namespace: one is enough, and all that is
    needed. Empty when he may not."""
    groups = {writer.group for writer in writers if writer.group in person.groups and namespace in writer.namespaces}
    return f"{GROUP_PREFIX}{min(groups)}" if groups else ""


@dataclass(frozen=True)
class ApplicationRequest:
    """What somebody asks for: an application of the catalogue with parameters, in an agent's namespace, of a manager;
    `manager` is empty where there is one alone."""

    namespace: str
    application: str
    parameters: Document
    priority: int | None
    reason: str
    manager: str

    def document(self, name: str, requester: str, now: str) -> dict[str, Any]:
        """The TaskDescription `name`; `now` is the time of asking."""
        spec: dict[str, Any] = {
            "requester": requester[:REQUESTER_CHARACTERS_MAX],
            "event": own_event(self.namespace, name, now),
            "application": self.application,
            "parameters": dict(self.parameters),
        }
        spec |= {"priority": self.priority} if self.priority is not None else {}
        spec |= {"reason": self.reason} if self.reason else {}
        head = {"apiVersion": f"{GROUP}/{VERSION}", "kind": "TaskDescription"}
        return {**head, "metadata": {"namespace": self.namespace, "name": name}, "spec": spec}

    def name(self, word: str) -> str:
        """A name for the task that nobody else has; `word` is random."""
        return f"{self.application}-{word}"


def read_request(document: Any) -> ApplicationRequest:
    """The request in a document; DocumentError names every problem. What the parameters may be the manager says."""
    reader = Reader("the request")
    optional = ["parameters", "priority", "reason", "manager"]
    given = reader.mapping(document, "", ["namespace", "application"], optional)
    parameters = given.get("parameters", {})
    if not isinstance(parameters, Mapping):
        reader.problems.append("parameters: must be a mapping")
    priority = _whole(given["priority"]) if "priority" in given else None
    if "priority" in given and (priority is None or not 0 <= priority <= PRIORITY_MAX):
        reader.problems.append(f"priority: must be a whole number from 0 to {PRIORITY_MAX}")
    reason = reader.prose(given.get("reason", ""), "reason")
    if len(reason) > REASON_CHARACTERS_MAX or not reason.isprintable():
        reader.problems.append(f"reason: must be one line of at most {REASON_CHARACTERS_MAX} characters")
    request = ApplicationRequest(
        namespace=reader.word(given.get("namespace"), "namespace", NAME),
        application=reader.word(given.get("application"), "application", NAME),
        parameters=parameters,
        priority=priority,
        reason=reason,
        manager=reader.word(given["manager"], "manager", NAME) if "manager" in given else "",
    )
    reader.finish()
    return request


def _whole(value: Any) -> int | None:
    """The whole number `value`, which JSON may write as 7.0, too; None when it is none."""
    whole = type(value) is int or (type(value) is float and value.is_integer())
    return int(value) if whole else None
