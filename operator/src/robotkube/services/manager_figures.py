"""What stands in the manager's metrics as a state, read when somebody asks: tasks, queue, main, agents, holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotkube.domain.scopes import unknown_nodes
from robotkube.domain.tasks import REASONS, is_withdrawn
from robotkube.ports.clusters import Cluster, TaskStore

OTHER = "Other"


@dataclass(frozen=True)
class Figures:
    """`tasks`: (condition, status, reason) -> how many; `waiting` tasks whose releases are not on main; `broken_files`
    on main; `unknown_agents` that have a Node and are not declared; `holds` of agents; `leading` or standing by."""

    tasks: Mapping[tuple[str, str, str], int] = field(default_factory=dict)
    waiting: int = 0
    broken_files: int = 0
    unknown_agents: int = 0
    holds: int = 0
    leading: bool = True


@dataclass(frozen=True)
class FigureReader:
    """Reads from what is there already; nobody is asked over the network. `broken`, `holds` and `leading` are how the
    process knows of its own state."""

    store: TaskStore
    cluster: Cluster
    agents: frozenset[str]
    broken: Callable[[], int] = int
    holds: Callable[[], int] = int
    leading: Callable[[], bool] = lambda: True

    def read(self) -> Figures:
        """The figures of this moment."""
        tasks = [task for task in self.store.tasks() if not is_withdrawn(task)]
        unknown = {node.agent for node in unknown_nodes(self.cluster.nodes(), self.agents)}
        return Figures(
            tasks=counted(tasks),
            waiting=sum(_waits(task) for task in tasks),
            broken_files=self.broken(),
            unknown_agents=len(unknown),
            holds=self.holds(),
            leading=self.leading(),
        )


def counted(tasks: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str, str], int]:
    """How many tasks show which reason; a reason that is not of the closed list counts as `Other`."""
    found: Counter[tuple[str, str, str]] = Counter()
    for task in tasks:
        for condition in _conditions(task):
            kind, reason = str(condition.get("type")), str(condition.get("reason"))
            if kind in REASONS:
                found[kind, str(condition.get("status")), reason if reason in REASONS[kind] else OTHER] += 1
    return dict(found)


def _waits(task: Mapping[str, Any]) -> bool:
    """Neither on main nor refused for good."""
    states = {c.get("type"): (c.get("status"), c.get("reason")) for c in _conditions(task)}
    accepted, committed = states.get("Accepted", ("Unknown", "")), states.get("Committed", ("False", ""))
    return committed[0] != "True" and (accepted[0] != "False" or accepted[1] == "Postponed")


def _conditions(task: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    return list((task.get("status") or {}).get("conditions") or ())
