"""The values of the manager's gauges at one time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ManagerGauges:
    """The gauges. `tasks`: (condition, status, reason) -> how many; `waiting` tasks whose releases are not on main;
    `broken_files` on main; `unknown_agents` that have a Node and are not declared; `holds` of agents; `leading` or
    standing by; `updates`: state of a release in an update -> how many."""

    tasks: Mapping[tuple[str, str, str], int] = field(default_factory=dict)
    waiting: int = 0
    broken_files: int = 0
    unknown_agents: int = 0
    holds: int = 0
    leading: bool = True
    updates: Mapping[str, int] = field(default_factory=dict)
