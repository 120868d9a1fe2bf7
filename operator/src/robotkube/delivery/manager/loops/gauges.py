"""The manager's gauges, read when a page of metrics is made: tasks, queue, main, agents, holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robotkube.delivery.manager.core.gauges import ManagerGauges
from robotkube.delivery.manager.core.placement.scopes import unknown_nodes
from robotkube.delivery.manager.core.updates.states import ReleaseUpdate
from robotkube.delivery.manager.ports.cluster import Cluster
from robotkube.delivery.tasks.core.task_description import REASONS
from robotkube.delivery.tasks.ports.store import TaskStore
from robotkube.foundation.kubernetes.core.objects import is_withdrawn

OTHER = "Other"


@dataclass(frozen=True)
class GaugeReader:
    """A reader of the gauges from what the process knows already, without the network. `agents` gives the names of
    those that are there, `broken`, `holds`, `updates` and `leading` its own state."""

    store: TaskStore
    cluster: Cluster
    agents: Callable[[], Collection[str]]
    broken: Callable[[], int] = int
    holds: Callable[[], int] = int
    updates: Callable[[], Mapping[str, ReleaseUpdate]] = dict
    leading: Callable[[], bool] = lambda: True

    def read(self) -> ManagerGauges:
        """The gauges of this moment."""
        tasks = [task for task in self.store.tasks() if not is_withdrawn(task)]
        unknown = {node.agent for node in unknown_nodes(self.cluster.nodes(), self.agents())}
        return ManagerGauges(
            tasks=counted(tasks),
            waiting=sum(_waits(task) for task in tasks),
            broken_files=self.broken(),
            unknown_agents=len(unknown),
            holds=self.holds(),
            updates=Counter(update.state for update in self.updates().values()),
            leading=self.leading(),
        )


def counted(tasks: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str, str], int]:
    """The number of tasks by condition, status and reason; a reason that is not of the closed list counts as
    `Other`."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for task in tasks:
        for condition in _conditions(task):
            kind = str(condition.get("type"))
            reason = str(condition.get("reason"))
            if kind in REASONS:
                counts[kind, str(condition.get("status")), reason if reason in REASONS[kind] else OTHER] += 1
    return dict(counts)


def _waits(task: Mapping[str, Any]) -> bool:
    """Return whether a task is neither on main nor refused for good."""
    states = {c.get("type"): (c.get("status"), c.get("reason")) for c in _conditions(task)}
    accepted = states.get("Accepted", ("Unknown", ""))
    committed = states.get("Committed", ("False", ""))
    return committed[0] != "True" and (accepted[0] != "False" or accepted[1] == "Postponed")


def _conditions(task: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    return list((task.get("status") or {}).get("conditions") or ())
