"""What the console reads from, and the model as those see it who write into it and who answer from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robotkube.delivery.console.core.chains import View
from robotkube.delivery.console.core.signing_in import Person
from robotkube.delivery.console.core.table import Document, TableChange
from robotkube.foundation.documents.core.patterns import ALL


@dataclass(frozen=True)
class Detector:
    """A pod of an event detector: `<namespace>/<pod>`, the release `<namespace>/<name>`, the address of its pages, and
    the ConfigMap with its settings."""

    pod: str
    release: str
    host: str
    config_map: str


@dataclass(frozen=True)
class BridgePod:
    """A pod of a bridge: `<namespace>/<pod>`, the release `<namespace>/<name>`, and the address of its pages, empty
    while it is not ready."""

    pod: str
    release: str
    host: str


@dataclass(frozen=True)
class ManagerPages:
    """The pages of a manager: its name, the address in front of them, and the namespaces whose tasks it answers, `*`
    among them for all."""

    name: str
    url: str
    namespaces: frozenset[str] = frozenset({ALL})

    def answers(self, namespace: str) -> bool:
        """Return whether tasks in a namespace are this manager's."""
        return ALL in self.namespaces or namespace in self.namespaces


class Pages(Protocol):
    """Pages of processes."""

    def get(self, url: str) -> Mapping[str, Any]:
        """The JSON object at `url`; UnavailableError when nobody answers, or the answer is none."""
        ...

    def text(self, url: str) -> str:
        """The page at `url` as it is; UnavailableError when nobody answers, or the answer is none."""
        ...

    def sentences(self, url: str) -> Sequence[str]:
        """The JSON list of texts at `url`; UnavailableError when nobody answers, or the answer is none."""
        ...


class WhatIf(Protocol):
    """Managers, as they are asked what would become of a task."""

    def ask(self, url: str, question: Mapping[str, Any]) -> Mapping[str, Any]:
        """The explanation by the manager at `url`; InputError when the question is none, UnavailableError when nobody
        answers it now."""
        ...


class PeoplesTasks(Protocol):
    """TaskDescriptions, written in the name of somebody with the rights of one of his groups alone. InputError when the
    task is refused, RefusalError where these rights do not reach, UnavailableError when nobody answers."""

    def submit(self, person: Person, group: str, task: Mapping[str, Any]) -> bool:
        """Make a task; False when there is one of its name."""
        ...

    def withdraw(self, person: Person, group: str, namespace: str, name: str) -> bool:
        """Delete a task; False when there is none."""
        ...


class Settings(Protocol):
    """Settings documents of agents' processes."""

    def read(self, namespace: str, name: str) -> Mapping[str, Any]:
        """The document in a ConfigMap; empty when there is none. UnavailableError or InputError when it cannot be
        read."""
        ...


class ModelReading(Protocol):
    """The model as it is read, by any thread."""

    epoch: str
    now_ms: Callable[[], int]

    @property
    def version(self) -> int:
        """The version now."""
        ...

    def whole(self) -> TableChange:
        """All items."""
        ...

    def since(self, version: int) -> TableChange | None:
        """What changed after a version; None when that cannot be told."""
        ...

    def documents(self, kind: str) -> Mapping[str, Document]:
        """The documents of a kind, by key."""
        ...

    def view(self) -> View:
        """What chains are made of."""
        ...

    def listen(self, changed: Callable[[], None]) -> None:
        """Call `changed` after every change from now on; it must return at once."""
        ...


class ModelWriting(Protocol):
    """The model as sources write into it, from any thread; None: the item is gone."""

    def put(self, kind: str, key: str, document: Document | None) -> None:
        """An item is there with this document, or there is none."""
        ...

    def put_task(self, key: str, task: Document | None) -> None:
        """A task is there with this document, or there is none."""
        ...

    def put_release(self, key: str, release: Document | None) -> None:
        """A release is there with this document, or there is none."""
        ...

    def put_source(self, name: str, problem: str, advice: str, carries: Sequence[str]) -> None:
        """A source answers (`problem` is empty), or does not and why."""
        ...
