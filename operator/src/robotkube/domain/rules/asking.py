"""Conditions that are evaluated elsewhere: expressions and installed rules have processes of their own.

A condition of this kind asks and returns nothing; the answers come later, in the order of the questions.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from robotkube.domain.rules.conditions import Condition
from robotkube.domain.rules.edges import NOTHING, Cause
from robotkube.domain.rules.messages import Finding, Member, Reading, pair
from robotkube.domain.rules.specifications import PAIR, Cel, Rule


class Question(NamedTuple):
    """What a rule shall be evaluated for: a member with the fields' values, or (kind python) a message as it came."""

    rule: str
    member: Member
    topic: str
    stamp: int
    received: int
    values: Mapping[str, Any] = NOTHING
    type: str = ""
    data: bytes = b""
    evaluate: bool = True


class Answer(NamedTuple):
    """For whom a rule holds (RISE), does not hold (FALL) or may go on as before (KEEP)."""

    member: Member
    verdict: int
    detail: Mapping[str, float] = NOTHING
    causes: tuple[Cause, ...] = ()


class Verdict(NamedTuple):
    """The answers to a question."""

    question: Question
    answers: Sequence[Answer]


SERIES_MAX = 10_000
"""So many values of a series are handed to an expression."""

Ask = Callable[[Question], None]
Checked = tuple[str, tuple[str, ...]]
"""An expression and the names that it may use; of a pair `a.x` and `b.x`."""
Check = Callable[[Sequence[Checked]], Sequence[str]]
"""What is wrong with each expression, empty when nothing is."""


def names_of(settings: Cel, scope: str) -> tuple[str, ...]:
    """What the expressions of a rule may name."""
    names = (*settings.fields, "agent")
    return tuple(f"{one}.{name}" for one in "ab" for name in names) if scope == PAIR else names


def _plain(value: Any) -> Any:
    """A field's value as it can be handed to another process."""
    if not isinstance(value, (array, tuple)):
        return value
    if len(value) > SERIES_MAX:
        raise ValueError(f"a series of {len(value)} values is too long for an expression; at most {SERIES_MAX}")
    return tuple(value)


class ExpressionCondition(Condition):
    """An expression over the fields of one message, or over the latest ones of each two agents."""

    def __init__(self, rule: Rule, settings: Cel, ask: Ask) -> None:
        super().__init__()
        self._rule, self._settings, self._ask = rule, settings, ask
        self._names = tuple(settings.fields)
        self._latest: dict[str, Reading] = {}
        self._stale_ns = int(settings.stale_seconds * 1e9)

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """Ask."""
        if self._rule.scope != PAIR:
            values = {**self._named(reading), "agent": reading.agent}
            self._put((reading.agent,), reading, values)
            return ()
        self._latest[reading.agent] = reading
        for other, latest in self._latest.items():
            if other != reading.agent and abs(latest.stamp - reading.stamp) <= self._stale_ns:
                member = pair(reading.agent, other)
                a, b = (self._latest[agent] for agent in member)
                values = {"a": {**self._named(a), "agent": a.agent}, "b": {**self._named(b), "agent": b.agent}}
                self._put(member, reading, values)
        return ()

    def forget(self, agent: str) -> None:
        """See the base."""
        self._latest.pop(agent, None)

    def _named(self, reading: Reading) -> dict[str, Any]:
        return {name: _plain(value) for name, value in zip(self._names, reading.values, strict=True)}

    def _put(self, member: Member, reading: Reading, values: Mapping[str, Any]) -> None:
        self._ask(Question(self._rule.name, member, reading.topic, reading.stamp, reading.received, values))


class PluginCondition(Condition):
    """A rule of an installed package; it gets every message of its topics."""

    def __init__(self, rule: Rule, ask: Ask) -> None:
        super().__init__()
        self._rule, self._ask = rule, ask

    def observe(self, reading: Reading) -> Sequence[Finding]:
        """Ask."""
        self.show(reading, evaluate=True)
        return ()

    def show(self, reading: Reading, evaluate: bool) -> None:
        """Hand the message over; without `evaluate` only for the rule's windows."""
        topic, agent, stamp, received, _, type_name, data = reading
        member = (agent,)
        question = Question(self._rule.name, member, topic, stamp, received, NOTHING, type_name, data, evaluate)
        self._ask(question)
