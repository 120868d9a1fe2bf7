"""Managers and an API server in memory, as people ask them through the console."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotkube.delivery.console.adapters.web.asking import AskedParties
from robotkube.delivery.console.core.signing_in import Person
from robotkube.delivery.console.ports import ManagerPages
from robotkube.errors import RobotKubeError

MANAGER = "http://manager:8080"
EXPLANATION: dict[str, Any] = {
    "task": "cloud-0/recording-preview",
    "outcome": "Accepted",
    "reason": "Accepted",
    "message": "",
    "releases": ["cloud-0/recorder"],
    "waits": "",
    "lines": ["cloud-0/recording-preview is accepted; its releases: cloud-0/recorder"],
    "changes": [{"path": "releases/cloud-0/recorder.yaml", "before": None, "after": "kind: HelmRelease\n"}],
}


class PlatformInMemory:
    """The ports WhatIf and PeoplesTasks. `error` is raised by the next question or write."""

    def __init__(self) -> None:
        self.questions: list[tuple[str, Mapping[str, Any]]] = []
        self.tasks: dict[str, Mapping[str, Any]] = {}
        self.written: list[tuple[str, str]] = []
        self.names_are_taken = False
        self.error: RobotKubeError | None = None

    @property
    def asking(self) -> AskedParties:
        """The console's side of it, with two managers."""
        south = ManagerPages("south", "http://south:8080", frozenset({"cloud-1", "vehicle-01"}))
        north = ManagerPages("manager", MANAGER, frozenset({"cloud-0", "vehicle-00"}))
        return AskedParties([north, south], self, self)

    def ask(self, url: str, question: Mapping[str, Any]) -> Mapping[str, Any]:
        self._fail()
        self.questions.append((url, question))
        return EXPLANATION

    def submit(self, person: Person, group: str, task: Mapping[str, Any]) -> bool:
        self._fail()
        self.written.append((person.name, group))
        self.tasks[f"{task['metadata']['namespace']}/{task['metadata']['name']}"] = task
        return not self.names_are_taken

    def withdraw(self, person: Person, group: str, namespace: str, name: str) -> bool:
        self._fail()
        self.written.append((person.name, group))
        return self.tasks.pop(f"{namespace}/{name}", None) is not None

    def _fail(self) -> None:
        if self.error is not None:
            raise self.error
