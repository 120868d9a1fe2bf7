"""The way of edges from rules to the combinations of them, in the order of their stamps.

What shows itself by silence is told late: a message that says otherwise may be under way. An edge of another part with
a later stamp is there before it, and would make a combination begin that must not, or end too late. So edges wait while
a part may still tell something of an earlier moment.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

from robotkube.robots.rules.core.conditions.combinations import CombinationCondition
from robotkube.robots.rules.core.conditions.levels import GRACE_NS
from robotkube.robots.rules.core.evaluators import Evaluator
from robotkube.robots.rules.core.events import Edge

HELD_NS_MAX = 2 * GRACE_NS
"""The longest that an edge waits; where clocks differ, a part would be in doubt for as long as they do."""
NEVER = 1 << 63


class _Waiting(NamedTuple):
    """An edge that waits, at most `until` on this machine's clock."""

    edge: Edge
    until: int

    @property
    def stamp(self) -> int:
        return self.edge.stamp


_stamp = attrgetter("stamp")


class CombinationFeed:
    """The combinations among the evaluators, and the edges that wait for them. `due`: when the first has waited long
    enough, on this machine's clock; NEVER without one."""

    def __init__(self) -> None:
        self.due = NEVER
        self.combinations: list[Evaluator] = []
        self._parts: dict[str, list[Evaluator]] = {}
        self._waiting: dict[str, list[_Waiting]] = {}

    def bind(self, evaluators: Mapping[str, Evaluator]) -> None:
        """Feed the combinations among these evaluators, parts first; edges wait on for those that were there."""
        before = {evaluator.rule.name: evaluator for evaluator in self.combinations}
        self.combinations = [e for e in evaluators.values() if isinstance(e.condition, CombinationCondition)]
        self._parts = {}
        for evaluator in self.combinations:
            direct = [evaluators[name] for name in sorted(part_names(evaluator))]
            deeper = [part for other in direct for part in self._parts.get(other.rule.name, ())]
            self._parts[evaluator.rule.name] = list(dict.fromkeys([*direct, *deeper]))
        kept = [e.rule.name for e in self.combinations if before.get(e.rule.name) is e]
        self._waiting = {name: self._waiting[name] for name in kept if name in self._waiting}
        self._note_due()

    def waits(self, evaluator: Evaluator) -> bool:
        """Return whether edges of its parts wait for a combination: then time alone must not change it."""
        return bool(self._waiting.get(evaluator.rule.name))

    def pass_on(self, edges: Iterable[Edge], now: int) -> list[Edge]:
        """The edges with those of the combinations that follow them, at `now` on this machine's clock."""
        every = list(edges)
        for evaluator in self.combinations:
            names = part_names(evaluator)
            mine = [edge for edge in every if edge.rule in names]
            if mine or self._waiting.get(evaluator.rule.name):
                every += self._fed(evaluator, mine, now)
        self._note_due()
        return every

    def release(self) -> list[Edge]:
        """The edges of all combinations, with nothing that waits any more."""
        return self.pass_on((), NEVER)

    def _fed(self, evaluator: Evaluator, edges: Sequence[Edge], now: int) -> list[Edge]:
        name = evaluator.rule.name
        waiting = [*self._waiting.get(name, ()), *(_Waiting(edge, now + HELD_NS_MAX) for edge in edges)]
        waiting.sort(key=_stamp)
        ready = 0
        while ready < len(waiting):
            edge, until = waiting[ready]
            if until > now and self._in_doubt(name, edge.stamp):
                break
            ready += 1
        self._waiting[name] = waiting[ready:]
        return evaluator.follow([edge for edge, _ in waiting[:ready]]) if ready else []

    def _in_doubt(self, name: str, stamp: int) -> bool:
        parts = self._parts[name]
        return any(self._waiting.get(part.rule.name) or part.in_doubt(stamp) for part in parts)

    def _note_due(self) -> None:
        self.due = min((waiting.until for queue in self._waiting.values() for waiting in queue), default=NEVER)


def part_names(evaluator: Evaluator) -> frozenset[str]:
    """The rules that a combination is made of; empty for any other rule."""
    condition = evaluator.condition
    return condition.names if isinstance(condition, CombinationCondition) else frozenset()
