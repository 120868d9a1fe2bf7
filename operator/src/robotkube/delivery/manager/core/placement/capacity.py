"""Resources: what services ask for, what nodes have, and what is planned on each agent so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

from robotkube.foundation.documents.core.quantities import quantity

MEBIBYTE = 2**20


@dataclass(frozen=True)
class Resources:
    """Requests of a release, or what a node has for pods."""

    cpu_millicores: int = 0
    memory_bytes: int = 0

    def __add__(self, other: Resources) -> Resources:
        return Resources(self.cpu_millicores + other.cpu_millicores, self.memory_bytes + other.memory_bytes)

    def part(self, parts: int) -> Resources:
        """One of so many equal parts."""
        return Resources(self.cpu_millicores // parts, self.memory_bytes // parts)


NOTHING = Resources()


@dataclass(frozen=True)
class Capacity:
    """Resources of the nodes of one agent: together, and of the largest single node, on which each pod must fit."""

    total: Resources
    largest: Resources


def read_resources(written: Mapping[str, str]) -> Resources:
    """`{cpu: 30m, memory: 64Mi}` of a chart version or a Node; what is missing or no quantity counts as nothing."""
    return _resources(written.get("cpu", ""), written.get("memory", ""))


@lru_cache(1024)
def _resources(cpu: str, memory: str) -> Resources:
    cores, size = quantity(cpu), quantity(memory)
    return Resources(ceil(cores * 1000) if cores else 0, ceil(size) if size else 0)


class Occupancy:
    """Resources that are reserved on each agent, by name; `mark` and `undo` release those of a refused demand."""

    def __init__(self) -> None:
        self._millicores: dict[str, int] = {}
        self._bytes: dict[str, int] = {}
        self._releases: dict[str, int] = {}
        self._journal: list[tuple[str, Resources, int]] = []

    def copy(self) -> Occupancy:
        """An occupancy that can grow without changing this one; its journal starts empty."""
        copied = Occupancy()
        copied._millicores = dict(self._millicores)
        copied._bytes = dict(self._bytes)
        copied._releases = dict(self._releases)
        return copied

    def mark(self) -> int:
        """A point to go back to."""
        return len(self._journal)

    def undo(self, mark: int) -> None:
        """Undo everything since `mark`."""
        while len(self._journal) > mark:
            agent, need, releases = self._journal.pop()
            self._add(agent, Resources(-need.cpu_millicores, -need.memory_bytes), -releases)

    def reserve(self, agent: str, need: Resources, releases: int = 1) -> None:
        """Reserve resources on an agent for `releases` releases; 0 for one that is no load, such as a bridge."""
        self._journal.append((agent, need, releases))
        self._add(agent, need, releases)

    def _add(self, agent: str, need: Resources, releases: int) -> None:
        self._millicores[agent] = self._millicores.get(agent, 0) + need.cpu_millicores
        self._bytes[agent] = self._bytes.get(agent, 0) + need.memory_bytes
        self._releases[agent] = self._releases.get(agent, 0) + releases

    def load(self, agent: str) -> int:
        """Releases planned on an agent."""
        return self._releases.get(agent, 0)

    def fits(self, agent: str, capacity: Capacity | None, need: Resources) -> bool:
        """Return whether `need` fits beside what is planned; always, where the capacity is not known."""
        if capacity is None:
            return True
        total, largest = capacity.total, capacity.largest
        return (
            self._millicores.get(agent, 0) + need.cpu_millicores <= total.cpu_millicores
            and self._bytes.get(agent, 0) + need.memory_bytes <= total.memory_bytes
            and need.cpu_millicores <= largest.cpu_millicores
            and need.memory_bytes <= largest.memory_bytes
        )

    def shortage(self, agent: str, capacity: Capacity, need: Resources) -> str:
        """The resources that are missing, as text; for something that does not fit."""
        free = Resources(
            capacity.total.cpu_millicores - self._millicores.get(agent, 0),
            capacity.total.memory_bytes - self._bytes.get(agent, 0),
        )
        parts = []
        if need.cpu_millicores > min(free.cpu_millicores, capacity.largest.cpu_millicores):
            free_millicores = max(min(free.cpu_millicores, capacity.largest.cpu_millicores), 0)
            parts.append(f"cpu {need.cpu_millicores}m of {free_millicores}m free")
        if need.memory_bytes > min(free.memory_bytes, capacity.largest.memory_bytes):
            free_bytes = max(min(free.memory_bytes, capacity.largest.memory_bytes), 0)
            parts.append(f"memory {need.memory_bytes // MEBIBYTE}Mi of {free_bytes // MEBIBYTE}Mi free")
        return ", ".join(parts)
