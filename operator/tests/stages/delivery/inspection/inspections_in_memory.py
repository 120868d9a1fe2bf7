"""Inspections, nodes and workloads in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.delivery.inspection.adapters.kubernetes_workloads import OTHER_KINDS
from robotkube.delivery.inspection.core.permitted import Permitted
from robotkube.delivery.inspection.core.strangers import Look, Stranger
from robotkube.delivery.inspection.ports import NodeAddress, NodeReading
from robotkube.errors import InputError, UnavailableError


class InspectionsInMemory:
    """The port Inspections. `away`: nobody answers; `refuses`: admission takes no write; `changes`: what admission
    makes of a status that is written."""

    def __init__(self) -> None:
        self.statuses: dict[str, Mapping[str, Any]] = {}
        self.events: list[tuple[str, str, str]] = []
        self.writes = 0
        self.away = self.refuses = False
        self.changes: Callable[[Mapping[str, Any]], Mapping[str, Any]] = lambda status: status

    def names(self) -> tuple[str, ...]:
        return tuple(sorted(self.statuses))

    def standing(self, prefix: str) -> Mapping[str, Mapping[str, Any]]:
        self._answer()
        return {name: status for name, status in self.statuses.items() if name.startswith(prefix)}

    def status(self, name: str) -> Mapping[str, Any] | None:
        self._answer()
        return self.statuses.get(name)

    def write(self, look: Look, status: Mapping[str, Any]) -> Mapping[str, Any]:
        self._answer()
        self.writes += 1
        if self.refuses:
            raise InputError("inspections: a policy denied the request")
        self.statuses[look.name] = self.changes(status)
        return self.statuses[look.name]

    def remove(self, name: str) -> None:
        self.statuses.pop(name, None)

    def report(self, look: Look, reason: str, stranger: Stranger) -> None:
        self._answer()
        self.events.append((look.name, reason, str(stranger)))

    def conditions(self, name: str) -> dict[str, str]:
        """Type -> status of an Inspection's conditions."""
        return {entry["type"]: entry["status"] for entry in self.statuses[name]["conditions"]}

    def _answer(self) -> None:
        if self.away:
            raise UnavailableError("API server: no answer")


class NodesInMemory:
    """The port Nodes: readings by node; one of None does not answer."""

    def __init__(self, readings: dict[str, NodeReading | None]) -> None:
        self.readings = readings
        self.asked: list[str] = []

    def addresses(self) -> Sequence[NodeAddress]:
        return [NodeAddress(name, "10.0.0.1", 10250) for name in sorted(self.readings)]

    def read(self, node: NodeAddress) -> NodeReading:
        self.asked.append(node.name)
        reading = self.readings.get(node.name)
        if reading is None:
            raise UnavailableError(f"kubelet of node {node.name}: timed out")
        return reading


class WorkloadsInMemory:
    """The port Workloads."""

    kinds = OTHER_KINDS

    def __init__(self, *workloads: tuple[str, Mapping[str, Any]]) -> None:
        self.workloads = list(workloads)
        self.asked = 0

    def read(self, namespace: str, kind: str) -> Sequence[Mapping[str, Any]]:
        self.asked += 1
        return [item for one, item in self.workloads if one == kind and item["metadata"]["namespace"] == namespace]


class SourceInMemory:
    """The port PermittedSource; `next` counts after the next refresh. `away`: what it reads from does not answer."""

    def __init__(self, now: Permitted | None) -> None:
        self.now = now
        self.next: Permitted | None = None
        self.refreshed = 0
        self.away = False

    def refresh(self) -> None:
        self.refreshed += 1
        if self.away:
            raise UnavailableError("the forge does not answer")
        if self.next is not None:
            self.now = self.next

    def permitted(self) -> Permitted | None:
        return self.now


class Clock:
    """A clock that is moved by hand, in seconds."""

    def __init__(self, now: float = 1_000_000.0) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now

    def ns(self) -> int:
        return int(self.now * 1e9)
