"""The evaluator of one rule: its condition, its events, and the last message of each agent."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from robotkube.robots.rules.core.conditions.combinations import CombinationCondition
from robotkube.robots.rules.core.conditions.external import (
    AnsweredQuestion,
    AskRule,
    ExpressionCondition,
    PluginCondition,
)
from robotkube.robots.rules.core.conditions.levels import (
    GRACE_NS,
    GeofenceCondition,
    RuleCondition,
    ThresholdCondition,
    Timers,
    earliest,
)
from robotkube.robots.rules.core.conditions.proximity import ProximityCondition
from robotkube.robots.rules.core.conditions.rates import AbsenceCondition, RateCondition
from robotkube.robots.rules.core.event_tracking import EventTracker
from robotkube.robots.rules.core.events import Edge
from robotkube.robots.rules.core.messages import (
    FALL,
    KEEP,
    RISE,
    Agents,
    Member,
    MemberChange,
    MessageValues,
    NoNumberError,
)
from robotkube.robots.rules.core.specification.specifications import (
    GROUP,
    Absence,
    Always,
    Cel,
    Combination,
    Geofence,
    Proximity,
    Python,
    Rate,
    Rule,
    Threshold,
)

NEVER_NS = 1 << 63
AGENTS_MAX = 10_000
"""The most agents that one rule evaluates; messages of others are counted in `ignored`."""


class AlwaysCondition(RuleCondition):
    """The condition that holds from the first moment on."""

    def observe(self, reading: MessageValues) -> list[MemberChange]:
        """Nothing: messages do not change it."""
        return []


def condition_of(rule: Rule, rules: Mapping[str, Rule], ask: AskRule) -> RuleCondition:
    """A new condition of a rule, in its first state."""
    match rule.condition:
        case Proximity() as settings:
            return ProximityCondition(settings)
        case Geofence() as settings:
            return GeofenceCondition(settings)
        case Threshold() as settings:
            return ThresholdCondition(settings)
        case Rate() as settings:
            return RateCondition(settings)
        case Absence() as settings:
            return AbsenceCondition(settings, rule.agents)
        case Combination() as settings:
            return CombinationCondition(rule, settings, rules)
        case Cel() as settings:
            return ExpressionCondition(rule, settings, ask)
        case Python():
            return PluginCondition(rule, ask)
        case Always():
            return AlwaysCondition()


class Evaluator:
    """A rule with its state. `agent`: the agent to which the detector belongs."""

    def __init__(self, rule: Rule, rules: Mapping[str, Rule], agent: str, ask: AskRule) -> None:
        self.rule = rule
        self._agent = agent
        self.condition = condition_of(rule, rules, ask)
        self.events = EventTracker(rule)
        self.ignored = 0
        self._is_external = isinstance(rule.condition, (Cel, Python))
        self._expire_ns = int(rule.timing.expire * 1e9)
        self._every_ns = int(rule.timing.every * 1e9)
        self._silence_ns = self._expire_ns or NEVER_NS
        self._listed_agents = frozenset(rule.agents)
        self._seen: dict[str, tuple[int, int]] = {}
        self._slots: dict[str, int] = {}
        self._silences = Timers(self._silent_at)
        self._ends = Timers(self._end) if rule.scope == GROUP and self._expire_ns else None
        self._unseen: set[str] = set()
        self._begun = False

    def begin(self, stamp: int, received: int, parts: Sequence[Edge]) -> list[Edge]:
        """The edges of what holds from the first moment on, which the first call gives, and of what its `parts` say
        by then, of which the order of the past is not known any more."""
        edges: list[Edge] = []
        if isinstance(self.condition, CombinationCondition):
            for together in self.condition.moments(parts, at_once=True):
                edges += self._apply(self.condition.follow(together))
        if self._begun:
            return edges
        self._begun = True
        if isinstance(self.condition, AbsenceCondition):
            self.condition.begin(stamp, received)
        if isinstance(self.condition, CombinationCondition):
            edges += self._apply(self.condition.begin(stamp, received))
        if isinstance(self.condition, AlwaysCondition) and not self.events.active:
            edges += self._apply([MemberChange((self._agent,), RISE, stamp, received)])
        return edges

    def observe(self, reading: MessageValues, edges: list[Edge]) -> None:
        """Add the edges that a message causes to `edges`; ValueError when its fields are not what the rule compares,
        NoNumberError when they are no numbers this time.

        Edges that its arrival alone causes are added before."""
        _, agent, stamp, received, _, _, _ = reading
        if self._listed_agents and agent not in self._listed_agents:
            return
        if self._is_external:
            self._ask(reading)
            return
        if self._ends is not None:
            edges += self._expire_silent(stamp - 1, received)
        last = self._seen.get(agent)
        if last is None or stamp - last[0] > self._silence_ns or received < last[1] or agent in self.condition.paired:
            edges += self._note_message(agent, stamp, received)
            if agent not in self._seen:
                return
        else:  # heard of lately and alone: nothing can have expired, and the timer of its silence is set
            self._seen[agent] = stamp, received
        if self._every_ns and self._repeated(agent, stamp):
            return
        no_number: NoNumberError | None = None
        try:
            changes = self.condition.observe(reading)
        except NoNumberError as error:  # the time goes on all the same
            changes = ()
            no_number = error
        if changes:
            edges += self._apply(changes)
        if self.events.pending:
            edges += self._mature(agent, stamp, received)
        if no_number is not None:
            raise no_number

    def overlook(self, agent: str, received: int, stamp: int | None) -> None:
        """Note a sign of life of an agent: a message that is not evaluated, since it is older than the last one; of one
        whose `stamp` is not to be believed it is None."""
        last = self._seen.get(agent)
        if last is not None:
            self._seen[agent] = last[0], max(last[1], received)
        self.condition.overlook((agent,), received, stamp)

    def answer(self, answered: AnsweredQuestion) -> list[Edge]:
        """The edges that the answers to a question cause."""
        question = answered.question
        edges: list[Edge] = []
        agents = {*question.member, *(agent for answer in answered.answers for agent in answer.member)}
        edges += self._expire_silent(question.stamp - 1, question.received)
        for agent in sorted(agents):
            edges += self._note_message(agent, question.stamp, question.received)
        for answer in answered.answers:
            member = tuple(sorted(answer.member))
            holding = self.condition.holding
            if answer.verdict == KEEP or (answer.verdict == RISE) == (member in holding):
                continue
            change = MemberChange(
                member, answer.verdict, question.stamp, question.received, answer.detail, answer.causes
            )
            edges += self._apply([change])
        for agent in sorted(agents):
            edges += self._mature(agent, question.stamp, question.received)
        return edges

    def follow(self, edges: Sequence[Edge]) -> list[Edge]:
        """The edges that those of its parts cause."""
        assert isinstance(self.condition, CombinationCondition)
        caused: list[Edge] = []
        for together in self.condition.moments(edges):
            caused += self._apply(self.condition.follow(together))
        return caused

    def elapse(self, now: int) -> list[Edge]:
        """The edges that the time alone causes, up to `now` on this machine's clock."""
        edges: list[Edge] = []
        for agent in self._unseen - self._seen.keys():
            edges += self._note_message(agent, now, now)
        self._unseen.clear()
        for (agent,) in list(self._silences.passed(now)):
            end = self._end((agent,))
            edges += self._expire_silent(end, now) if end is not None and self._ends is not None else []
            edges += self._expire(agent, now) if agent in self._seen else []
        edges += self._apply(self.condition.elapse(now))
        beginning = self.events.beginning(now) if self._ends is not None else None
        edges += self._expire_silent(beginning, now) if beginning is not None else []
        return edges + self.events.elapse(now)

    def due(self) -> int | None:
        """The next moment at which `elapse` may give edges; None without one."""
        if self._unseen:
            return 0
        return earliest((self._silences.due(), self.condition.due(), self.events.due()))

    def in_doubt(self, stamp: int) -> bool:
        """Return whether the time alone may still show an edge at `stamp` or before it."""
        return self.condition.in_doubt(stamp) or self.events.in_doubt(stamp) or self._expires(stamp)

    def adopt(self, edge: Edge) -> bool:
        """Take over an event that began earlier; False when the rule cannot have it or has it already."""
        agents = self.events.adopt(edge)
        if agents is None:
            return False
        if not self.events.provisional:
            self.condition.mark(agents, True)
            self._unseen |= set(agents) if self._expire_ns else set()
        return True

    def restart(self, agent: str, stamp: int) -> None:
        """Begin an agent's time anew at `stamp`."""
        self._seen.pop(agent, None)
        self._slots.pop(agent, None)
        self.condition.forget(agent)
        self.events.restart(agent, stamp)

    def _ask(self, reading: MessageValues) -> None:
        repeated = bool(self._every_ns) and self._repeated(reading.agent, reading.stamp)
        if isinstance(self.condition, PluginCondition):
            self.condition.send(reading, not repeated)
        elif not repeated:
            self.condition.observe(reading)

    def _note_message(self, agent: str, stamp: int, received: int) -> list[Edge]:
        """Record a message of an agent; the edges that end its events when it was silent for too long before."""
        edges: list[Edge] = []
        if self._expire_ns:
            for other in [agent, *self.condition.partners(agent)]:
                if other in self._seen and stamp - self._seen[other][0] > self._expire_ns:
                    edges += self._expire(other, received)
        if agent not in self._seen and len(self._seen) >= AGENTS_MAX:
            self.ignored += 1
            return edges
        self._seen[agent] = (stamp, received)
        if self._expire_ns:
            self._silences.watch((agent,), received + self._expire_ns + GRACE_NS)
        if self._ends is not None:
            self._ends.watch((agent,), stamp + self._expire_ns)
        return edges

    def _expire_silent(self, stamp: int, received: int) -> list[Edge]:
        """The edges of agents of a group whose silence was too long up to `stamp`.

        A group has one time: such an agent leaves it before anything later counts, in the order of stamps, whichever
        agent sends and whenever the clock is read."""
        if self._ends is None or not (gone := [agent for (agent,) in self._ends.passed(stamp)]):
            return []
        ordered = sorted(gone, key=lambda agent: (self._seen[agent][0], agent))
        return [edge for agent in ordered for edge in self._expire(agent, received)]

    def _expires(self, stamp: int) -> bool:
        """Return whether an agent for which it holds has been silent for too long at `stamp`."""
        if not self._expire_ns:
            return False
        ends = (self._end((agent,)) for member in self.condition.holding for agent in member)
        return any(end is not None and end <= stamp for end in ends)

    def _expire(self, agent: str, now: int) -> list[Edge]:
        gone = sorted(member for member in self.condition.holding if agent in member)
        ends = [
            min(self._seen[other][0] for other in member if other in self._seen) + self._expire_ns for member in gone
        ]
        del self._seen[agent]
        self._slots.pop(agent, None)
        self.condition.forget(agent)
        return self._apply([MemberChange(member, FALL, end, now) for member, end in zip(gone, ends, strict=True)])

    def _end(self, member: Member) -> int | None:
        """The stamp at which an agent's silence is too long, in its own time."""
        last = self._seen.get(member[0])
        return None if last is None else last[0] + self._expire_ns

    def _silent_at(self, member: Member) -> int | None:
        last = self._seen.get(member[0])
        return None if last is None else last[1] + self._expire_ns + GRACE_NS

    def _repeated(self, agent: str, stamp: int) -> bool:
        """Return whether the agent has been evaluated in this span of time."""
        slot = stamp // self._every_ns
        repeated = self._slots.get(agent) == slot
        self._slots[agent] = slot
        return repeated

    def _apply(self, changes: Iterable[MemberChange]) -> list[Edge]:
        edges: list[Edge] = []
        for change in changes:
            self.condition.mark(change.member, change.verdict == RISE)
            edges += self.events.apply(change)
        return edges

    def _mature(self, agent: str, stamp: int, received: int) -> list[Edge]:
        """The start edges of what has held for long enough for all of its agents."""
        edges: list[Edge] = []
        for agents in self.events.waiting(agent):
            edges += self.events.mature(agents, self._progress(agents, stamp), received)
        return edges

    def _progress(self, agents: Agents, stamp: int) -> int:
        if self.rule.scope == GROUP:
            return stamp
        return min((self._seen[agent][0] for agent in agents if agent in self._seen), default=stamp)
