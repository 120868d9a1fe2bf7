"""Conditions that are evaluated in processes of their own: expressions, and rules of installed packages.

A condition of this kind sends a question and gives no change; answers come later, in the order of the questions.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from robotkube.robots.rules.core.conditions.levels import RuleCondition
from robotkube.robots.rules.core.conditions.pairs import ApartPairs
from robotkube.robots.rules.core.events import NOTHING, Cause
from robotkube.robots.rules.core.messages import Member, MemberChange, MessageValues, pair
from robotkube.robots.rules.core.specification.specifications import PAIR, Cel, Rule


class RuleQuestion(NamedTuple):
    """One evaluation of a rule: a member with the fields' values, or (kind python) a message as it came."""

    rule: str
    member: Member
    topic: str
    stamp: int
    received: int
    values: Mapping[str, Any] = NOTHING
    type: str = ""
    data: bytes = b""
    evaluate: bool = True


class RuleAnswer(NamedTuple):
    """The result of a rule for one member: it holds (RISE), does not hold (FALL) or goes on as before (KEEP)."""

    member: Member
    verdict: int
    detail: Mapping[str, float] = NOTHING
    causes: tuple[Cause, ...] = ()


class AnsweredQuestion(NamedTuple):
    """A question with its answers."""

    question: RuleQuestion
    answers: Sequence[RuleAnswer]


SERIES_MAX = 10_000
"""The most values of a series that an expression gets."""

AskRule = Callable[[RuleQuestion], None]


def _plain(value: Any) -> Any:
    """A field's value in a form that another process can get."""
    if not isinstance(value, (array, tuple)):
        return value
    if len(value) > SERIES_MAX:
        raise ValueError(f"a series of {len(value)} values is too long for an expression; at most {SERIES_MAX}")
    return tuple(value)


class ExpressionCondition(RuleCondition):
    """A condition by an expression over the fields of one message, or over the latest ones of each two agents."""

    def __init__(self, rule: Rule, settings: Cel, ask: AskRule) -> None:
        super().__init__()
        self._rule = rule
        self._settings = settings
        self._ask = ask
        self._names = tuple(settings.fields)
        self._latest: dict[str, MessageValues] = {}
        self._stale_ns = int(settings.stale_seconds * 1e9)
        self.apart: ApartPairs = ApartPairs(self._stale_ns)

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """Send a question for each member that the message concerns."""
        if self._rule.scope != PAIR:
            values = {**self._named(reading), "agent": reading.agent}
            self._ask_about((reading.agent,), reading, values)
            return ()
        self._latest[reading.agent] = reading
        for other, latest in self._latest.items():
            if other == reading.agent:
                continue
            if abs(latest.stamp - reading.stamp) > self._stale_ns:
                mine = reading.agent, reading.stamp, reading.received
                self.apart.note(*mine, other, latest.stamp, latest.received)
                continue
            member = pair(reading.agent, other)
            a, b = (self._latest[agent] for agent in member)
            values = {"a": {**self._named(a), "agent": a.agent}, "b": {**self._named(b), "agent": b.agent}}
            self._ask_about(member, reading, values)
        return ()

    def forget(self, agent: str) -> None:
        """See the base."""
        self._latest.pop(agent, None)

    def _named(self, reading: MessageValues) -> dict[str, Any]:
        return {name: _plain(value) for name, value in zip(self._names, reading.values, strict=True)}

    def _ask_about(self, member: Member, reading: MessageValues, values: Mapping[str, Any]) -> None:
        self._ask(RuleQuestion(self._rule.name, member, reading.topic, reading.stamp, reading.received, values))


class PluginCondition(RuleCondition):
    """A condition by a rule of an installed package, which gets every message of its topics."""

    def __init__(self, rule: Rule, ask: AskRule) -> None:
        super().__init__()
        self._rule = rule
        self._ask = ask

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """Send the message as a question."""
        self.send(reading, evaluate=True)
        return ()

    def send(self, reading: MessageValues, evaluate: bool) -> None:
        """Send the message; without `evaluate` it only enters the rule's window."""
        topic, agent, stamp, received, _, type_name, data = reading
        member = (agent,)
        question = RuleQuestion(self._rule.name, member, topic, stamp, received, NOTHING, type_name, data, evaluate)
        self._ask(question)
