"""What the manager has done since its start: counted here, and passed on to whoever listens (metrics, traces)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from robotkube.ports.telemetry import PlanFacts, Telemetry
from robotkube.services.manager_records import PlanRecord


@dataclass
class ManagerStatistics:
    """`plans` by outcome (telemetry.OUTCOMES); `term` is 0 while another process leads, `broken_files` are main's."""

    plans: Counter[str] = field(default_factory=Counter)
    term: int = 0
    broken_files: int = 0
    listeners: tuple[Telemetry, ...] = ()

    def plan(self, record: PlanRecord, outcome: str) -> None:
        """A plan has come one step further."""
        self.plans[outcome] += 1
        facts = facts_of(record)
        for listener in self.listeners:
            listener.plan(facts, outcome)

    def step(self, failed: bool = False) -> None:
        """A step has ended."""
        for listener in self.listeners:
            listener.step(failed)

    def decided(self, seconds: float) -> None:
        """A decision was made."""
        for listener in self.listeners:
            listener.decided(seconds)


def facts_of(record: PlanRecord) -> PlanFacts:
    """The record as listeners are told of it: what no event asked for stands in a trace of the plan's own."""
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
