"""Plans that were refused: what they held is not proposed again, until its inputs change or the forge may be asked
again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Protocol

from robotkube.delivery.manager.loops.proposals.plan_records import PlanRecord

HELD_MAX = 1000
FORGE_REFUSAL_SECONDS = 300.0  # a right that an account got back changes nothing that a manager reads


class RefusedPlans:
    """Tasks that are held with what they followed from, and differences that no task alone stands for."""

    def __init__(self) -> None:
        self._tasks: dict[str, tuple[str, PlanRecord]] = {}
        self._differences: dict[str, PlanRecord] = {}

    @property
    def tasks(self) -> Mapping[str, PlanRecord]:
        """The held tasks with the plan that was refused."""
        return {key: record for key, (_, record) in self._tasks.items()}

    def holds(self, fingerprint: Callable[[], str]) -> bool:
        """Return whether differences of this fingerprint were refused; it is asked for only where any were."""
        return bool(self._differences) and fingerprint() in self._differences

    def hold_task(self, key: str, inputs: str, record: PlanRecord) -> None:
        """Hold a task until its inputs, as text, are others."""
        self._tasks[key] = (inputs, record)

    def hold_differences(self, fingerprint: str, record: PlanRecord) -> None:
        """Hold exactly these; the oldest go when there are too many."""
        self._differences[fingerprint] = record
        while len(self._differences) > HELD_MAX:
            self._differences.pop(next(iter(self._differences)))

    def keep(self, inputs: Callable[[str], str | None]) -> None:
        """Hold only tasks whose inputs are as they were; `inputs` gives None for one that is gone."""
        self._tasks = {key: held for key, held in self._tasks.items() if held[0] == inputs(key)}

    def forget(self, plans: Collection[str]) -> None:
        """Hold no longer what these plans were refused for."""
        self._tasks = {key: held for key, held in self._tasks.items() if held[1].id not in plans}
        self._differences = {key: record for key, record in self._differences.items() if record.id not in plans}


class Forgetting(Protocol):
    """Who holds what was refused."""

    def forget(self, plans: Collection[str]) -> None:
        """Hold no longer what these plans were refused for."""
        ...


class ForgeRefusals:
    """Plans that the forge itself refused. They are held like what the gate refuses, but not for ever: the gate judges
    what is proposed, and the forge who may propose. `monotonic` is a clock in seconds that never goes back."""

    def __init__(self, monotonic: Callable[[], float], *holders: Forgetting) -> None:
        self._monotonic = monotonic
        self._holders = holders
        self._plans: set[str] = set()
        self._until = float("inf")

    def add(self, plan: str) -> None:
        """Note that the forge refused this plan."""
        if not self._plans:
            self._until = self._monotonic() + FORGE_REFUSAL_SECONDS
        self._plans.add(plan)

    def forget_when_due(self) -> bool:
        """Have what the forge refused proposed again when it is time for that; whether it is."""
        if self._monotonic() < self._until:
            return False
        for holder in self._holders:
            holder.forget(self._plans)
        self._plans = set()
        self._until = float("inf")
        return True
