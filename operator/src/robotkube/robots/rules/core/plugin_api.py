"""The interface of rules that installed packages add. Public API; docs/how-to/write-a-plugin.md shows a whole package.

A package names a factory in the entry point group `robotkube.rules`. The factory gets the rule's `settings` and gives
an object with `evaluate`. It runs in a process of its own: what it does with time and memory harms nobody else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from robotkube.robots.ros.core.cdr_readers.readers import Layouts
from robotkube.robots.ros.core.ring_buffers import BufferBounds, RingBuffer, Sample
from robotkube.robots.rules.core.conditions.external import RuleAnswer, RuleQuestion
from robotkube.robots.rules.core.events import Cause
from robotkube.robots.rules.core.messages import FALL, RISE
from robotkube.robots.rules.core.windows import Window

ENTRY_POINT_GROUP = "robotkube.rules"
BUFFER_BYTES_MAX = 64 * 1024 * 1024
BUFFERS_MAX = 1000
ANSWERS_MAX = 1000


class Arrival(NamedTuple):
    """The message because of which a rule is evaluated; it is the newest one of its topic in the window.

    `stamp`: when it was measured, ns since 1970: the rule's present time. A rule must not ask a clock, or a replay
    would say something else than life.
    """

    topic: str
    agent: str
    stamp: int
    received: int


@dataclass(frozen=True)
class Holding:
    """The state of a rule for one agent, or for two when its scope is pair: it holds, or does not.

    `detail`: numbers that go with the event. `causes`: the messages and values that explain it.
    """

    agents: tuple[str, ...]
    holds: bool
    detail: Mapping[str, float] = field(default_factory=dict)
    causes: tuple[Cause, ...] = ()


class InstalledRule(Protocol):
    """The object that a factory gives."""

    def evaluate(self, arrival: Arrival, window: Window) -> Iterable[Holding]:
        """The agents for whom the rule holds now, and for whom it does not; others stay as they were.

        An exception suspends the rule."""


Factory = Callable[[Mapping[str, Any]], InstalledRule]


class PluginHost:
    """An installed rule with buffers of its own, fed by questions in the order of the messages.

    `patterns`: topic pattern -> message type, for the topics of the rule.
    """

    def __init__(
        self, rule: InstalledRule, patterns: Mapping[str, str], layouts: Layouts, buffer_seconds: float
    ) -> None:
        self._rule = rule
        self._bounds = BufferBounds(buffer_seconds, BUFFER_BYTES_MAX)
        self._buffers: dict[str, RingBuffer] = {}
        self._window = Window(self._buffers, patterns, layouts)

    def answer(self, question: RuleQuestion) -> list[RuleAnswer]:
        """Insert the message, and evaluate the rule when the question says so."""
        buffer = self._buffers.get(question.topic)
        if buffer is None:
            if len(self._buffers) >= BUFFERS_MAX:
                del self._buffers[min(self._buffers, key=self._last_received)]
            buffer = self._buffers[question.topic] = RingBuffer(self._bounds, judges=False)
        if question.stamp < buffer.clock.newest:  # the topic's time has begun anew: otherwise questions are in order
            buffer.clear()
        buffer.insert(Sample(question.stamp, question.received, question.data))
        if not question.evaluate:
            return []
        arrival = Arrival(question.topic, question.member[0], question.stamp, question.received)
        answers = [_answer(holding) for holding in self._rule.evaluate(arrival, self._window)]
        if len(answers) > ANSWERS_MAX:
            raise ValueError(f"it gave {len(answers)} answers to one message; at most {ANSWERS_MAX}")
        return answers

    def _last_received(self, topic: str) -> int:
        newest = self._buffers[topic].latest()
        return newest.received if newest else 0


def _answer(holding: Holding) -> RuleAnswer:
    agents = tuple(sorted(str(agent) for agent in holding.agents))
    if not 1 <= len(agents) <= 2:
        raise ValueError(f"it answers for {len(agents)} agents: {', '.join(agents)}; it must be one, or two of a pair")
    detail = {str(key): float(value) for key, value in holding.detail.items()}
    return RuleAnswer(agents, RISE if holding.holds else FALL, detail, tuple(holding.causes))
