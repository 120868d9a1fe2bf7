"""Telemetry of the manager's work: steps, decisions and plans, for whoever counts, times or traces them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

OUTCOMES = ("proposed", "taken_over", "merged", "refused", "outdated", "superseded", "observed", "unobserved")


@dataclass(frozen=True)
class PlanFacts:
    """One plan as far as it has come. `kind` is its cause (task, withdrawal, initial, update, node, repair, revert);
    `times` are ns since 1970 by step (plan_records.TIMES); `traces` those of its events, 32 hexadecimal digits."""

    id: str
    kind: str
    commit: str = ""
    pull_request: int | None = None
    tasks: tuple[str, ...] = ()
    traces: tuple[str, ...] = ()
    times: Mapping[str, int] = field(default_factory=dict)
    error: str = ""


class Telemetry(Protocol):
    """A listener to the manager's work; its calls return at once and never raise."""

    def step(self, failed: bool) -> None:
        """Note that one step of the loop has ended."""
        ...

    def decided(self, seconds: float) -> None:
        """Note the time of a decision: from what was read to the finished plan, or to its being known that there is
        none."""
        ...

    def plan(self, plan: PlanFacts, outcome: str) -> None:
        """Note that a plan has come one step further (one of OUTCOMES)."""
        ...
