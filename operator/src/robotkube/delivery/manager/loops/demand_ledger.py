"""The manager's ledger: the demands that stand now, and what was decided about each of them before.

Earlier decisions are kept for one generation of one object; after a restart they are read from the tasks' statuses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from robotkube.delivery.deployment.core.releases import TaskCause
from robotkube.delivery.manager.core.composition.inputs import Met, Refused
from robotkube.delivery.manager.core.conflicts import DemandOutcome, History, Postponed, Resolution
from robotkube.delivery.manager.core.standing_demands import (
    Asked,
    PastDecision,
    Stamp,
    StandingDemands,
    TaskReader,
    demands_at,
    moment,
    past_decision,
)
from robotkube.delivery.tasks.core.task_description import SETTLED_REASONS, SUPERSEDED, TaskDescription

NOTHING_TO_REMEMBER = PastDecision()


class DemandLedger:
    """The ledger of demands and their outcomes, by task; nothing outlives its task."""

    def __init__(self) -> None:
        self._reader = TaskReader()
        self._known: dict[str, tuple[Stamp, PastDecision]] = {}
        self._outcomes: dict[str, DemandOutcome] = {}
        self._causes: Collection[TaskCause] = ()
        self._answered: frozenset[str] = frozenset()
        self._asked: frozenset[tuple[str, str]] = frozenset()
        self.demands = StandingDemands()

    def read(self, documents: Sequence[Mapping[str, Any]], now_ns: int) -> StandingDemands:
        """Read the tasks, and return the demands that stand at `now_ns`."""
        self.demands = demands_at(self._reader.read(documents), now_ns)
        known: dict[str, tuple[Stamp, PastDecision]] = {}
        for key, task in self.demands.live.items():
            stamp = (task.identity, task.generation)
            memory = self._known.get(key)
            if memory is not None and memory[0] == stamp:
                known[key] = memory
            else:
                known[key] = stamp, past_decision(self._reader.document(key))
                self._outcomes.pop(key, None)
        self._known = known
        self._outcomes = {key: outcome for key, outcome in self._outcomes.items() if key in known}
        return self.demands

    def asked(self) -> Mapping[str, Asked]:
        """What each task asked for when it was read last."""
        return self._reader.asked()

    def foresee(self, document: Mapping[str, Any], now_ns: int) -> TaskDescription | Refused:
        """The demand that a document would make at `now_ns`, which is its creation unless it states another."""
        metadata = {"creationTimestamp": moment(now_ns), "generation": 1, **document.get("metadata", {})}
        entries = TaskReader().read([{**document, "metadata": metadata}])
        demands = demands_at(entries, now_ns)
        for key in entries:
            return demands.live.get(key) or demands.refused[key]
        return Refused(SUPERSEDED, "it is being deleted")

    def history(self, causes: Collection[TaskCause]) -> History:
        """Earlier decisions about the demands that stand; `causes` are those of main's releases."""
        decided = [(key, memory) for key, (_, memory) in self._known.items() if memory is not NOTHING_TO_REMEMBER]
        answered, parameters = self._asked_for(causes)
        return History(
            {key: m.waiting_since_ns for key, m in decided if m.waiting_since_ns is not None},
            {key: m.settled for key, m in decided if m.settled is not None},
            frozenset(key for key, memory in decided if memory.offloaded),
            answered,
            frozenset(key for key, task in self.demands.live.items() if (key, task.cause.parameters) not in parameters),
        )

    def answered(self, causes: Collection[TaskCause]) -> frozenset[str]:
        """The tasks that main answers, by the `causes` of its releases."""
        return self._asked_for(causes)[0]

    def _asked_for(self, causes: Collection[TaskCause]) -> tuple[frozenset[str], frozenset[tuple[str, str]]]:
        """The tasks of the causes, and what each asked with; computed once for the same object."""
        if self._causes is not causes:
            self._causes = causes
            self._answered = frozenset(cause.task for cause in causes)
            self._asked = frozenset((cause.task, cause.parameters) for cause in causes)
        return self._answered, self._asked

    def keep(self, resolution: Resolution) -> None:
        """Remember what was decided just now."""
        for key, outcome in resolution.outcomes.items():
            known = self._known.get(key)
            if known is not None:
                memory = _memory(outcome, key in resolution.offloaded)
                if known[1] is not memory:
                    self._known[key] = known[0], memory
                self._outcomes[key] = outcome

    @property
    def offloaded(self) -> frozenset[str]:
        """Demands that run elsewhere than their applications say."""
        return frozenset(key for key, (_, memory) in self._known.items() if memory.offloaded)

    @property
    def outcomes(self) -> Mapping[str, DemandOutcome]:
        """The last outcome of every demand that stands and was decided, and the refusals of tasks that are none."""
        return {**self._outcomes, **self.demands.refused}

    def split(self, tasks: Iterable[TaskDescription]) -> tuple[list[TaskDescription], list[TaskDescription]]:
        """The tasks that are new to the ledger or met, and those that were refused or postponed and may be decided
        again. Settled ones are in neither."""
        fresh: list[TaskDescription] = []
        again: list[TaskDescription] = []
        for task in tasks:
            if self._known[task.key][1].settled is None:
                known = isinstance(self._outcomes.get(task.key, Met((), ())), Met)
                (fresh if known else again).append(task)
        return fresh, again


def _memory(outcome: DemandOutcome, offloaded: bool) -> PastDecision:
    if isinstance(outcome, Postponed):
        return PastDecision(waiting_since_ns=outcome.since_ns)
    if isinstance(outcome, Refused) and outcome.reason in SETTLED_REASONS:
        return PastDecision(settled=outcome)
    return PastDecision(offloaded=True) if offloaded else NOTHING_TO_REMEMBER
