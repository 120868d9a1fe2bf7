"""The manager's counters since its start, passed on to listeners (metrics, traces)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from robotkube.delivery.manager.core.updates.steps import Updates
from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord
from robotkube.delivery.manager.ports.telemetry import PlanFacts, Telemetry


@dataclass
class ManagerStatistics:
    """The manager's counters. `plans` by outcome (telemetry.OUTCOMES); `term` is 0 while another process leads,
    `broken_files` are main's, `updates` what was decided about updates the last time."""

    plans: Counter[str] = field(default_factory=Counter)
    term: int = 0
    broken_files: int = 0
    updates: Updates = field(default_factory=Updates)
    listeners: tuple[Telemetry, ...] = ()

    def plan(self, record: PlanRecord, outcome: str) -> None:
        """Count a plan that has come one step further."""
        self.plans[outcome] += 1
        facts = facts_of(record)
        for listener in self.listeners:
            listener.plan(facts, outcome)

    def step(self, failed: bool = False) -> None:
        """Report to the listeners that a step has ended."""
        for listener in self.listeners:
            listener.step(failed)

    def decided(self, seconds: float, updates: Updates) -> None:
        """Report to the listeners how long a decision took; `updates` is its part about updates."""
        self.updates = updates
        for listener in self.listeners:
            listener.decided(seconds)

    def updates_page(self) -> dict[str, Any]:
        """The document of GET /updates."""
        updates = self.updates
        withheld = [
            {"chart": chart, "version": version, "reason": reason}
            for (chart, version), reason in sorted(updates.withheld.items())
        ]
        releases = {key: {"state": one.state, "text": one.text} for key, one in sorted(updates.states.items())}
        return {"messages": list(updates.messages), "withheld": withheld, "releases": releases}


def facts_of(record: PlanRecord) -> PlanFacts:
    """The record as listeners get it; a plan that no event asked for has a trace of its own."""
    return PlanFacts(
        id=record.id,
        kind=record.cause,
        commit=record.commit,
        pull_request=record.pull_request,
        tasks=record.tasks,
        traces=record.traces or (record.id,),
        times=dict(record.times),
        error=record.error or "",
    )
