"""One rule at work: its condition, its events, and when each agent was last heard of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from robotkube.domain.rules.asking import Ask, ExpressionCondition, PluginCondition, Verdict
from robotkube.domain.rules.combinations import CombinationCondition
from robotkube.domain.rules.conditions import (
    GRACE_NS,
    Condition,
    GeofenceCondition,
    ThresholdCondition,
    Timers,
    earliest,
)
from robotkube.domain.rules.edges import Edge
from robotkube.domain.rules.messages import FALL, KEEP, RISE, Agents, Finding, Member, Reading
from robotkube.domain.rules.occurrences import Occurrences
from robotkube.domain.rules.proximities import ProximityCondition
from robotkube.domain.rules.rates import AbsenceCondition, RateCondition
from robotkube.domain.rules.specifications import (
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
"""So many agents are looked at by one rule; what others send is counted in `ignored`."""


class AlwaysCondition(Condition):
    """Holds from the first moment on."""

    def observe(self, reading: Reading) -> list[Finding]:
        """Messages change nothing."""
        return []


def condition_of(rule: Rule, rules: Mapping[str, Rule], ask: Ask) -> Condition:
    """The beginning of a rule's condition."""
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
    """A rule with what it remembers. `agent`: whose detector it is."""

    def __init__(self, rule: Rule, rules: Mapping[str, Rule], agent: str, ask: Ask) -> None:
        self.rule, self._agent = rule, agent
        self.condition = condition_of(rule, rules, ask)
        self.occurrences = Occurrences(rule)
        self.ignored = 0
        self._asked = isinstance(rule.condition, (Cel, Python))
        self._expire_ns, self._every_ns = int(rule.timing.expire * 1e9), int(rule.timing.every * 1e9)
        self._silence_ns = self._expire_ns or NEVER_NS
        self._only = frozenset(rule.agents)
        self._seen: dict[str, tuple[int, int]] = {}
        self._slots: dict[str, int] = {}
        self._silences = Timers(self._silent_at)
        self._ends = Timers(self._end) if rule.scope == GROUP and self._expire_ns else None
        self._unseen: set[str] = set()
        self._begun = False

    def begin(self, stamp: int, received: int) -> list[Edge]:
        """What holds from the first moment on; to be called before anything else, again and again if need be."""
        if self._begun:
            return []
        self._begun = True
        if isinstance(self.condition, AbsenceCondition):
            self.condition.begin(stamp, received)
        if isinstance(self.condition, CombinationCondition):
            return self._take(self.condition.begin(stamp, received))
        if isinstance(self.condition, AlwaysCondition) and not self.occurrences.active:
            return self._take([Finding((self._agent,), RISE, stamp, received)])
        return []

    def observe(self, reading: Reading, found: list[Edge]) -> None:
        """Add the edges that a message causes to `found`; ValueError when its fields are not what the rule compares,
        after those that its coming alone has caused."""
        _, agent, stamp, received, _, _, _ = reading
        if self._only and agent not in self._only:
            return
        if self._asked:
            self._ask(reading)
            return
        if self._ends is not None:
            found += self._pass(stamp - 1, received)
        last = self._seen.get(agent)
        if last is None or stamp - last[0] > self._silence_ns or received < last[1] or agent in self.condition.paired:
            found += self._hear(agent, stamp, received)
            if agent not in self._seen:
                return
        else:  # heard of lately and alone: nothing can have expired, and who looks after its silence is set
            self._seen[agent] = stamp, received
        if self._every_ns and self._repeated(agent, stamp):
            return
        findings = self.condition.observe(reading)
        if findings:
            found += self._take(findings)
        if self.occurrences.pending:
            found += self._mature(agent, stamp, received)

    def answer(self, verdict: Verdict) -> list[Edge]:
        """The edges that come of the answers to a question."""
        question = verdict.question
        found: list[Edge] = []
        agents = {*question.member, *(agent for answer in verdict.answers for agent in answer.member)}
        found += self._pass(question.stamp - 1, question.received)
        for agent in sorted(agents):
            found += self._hear(agent, question.stamp, question.received)
        for answer in verdict.answers:
            member, holding = tuple(sorted(answer.member)), self.condition.holding
            if answer.verdict == KEEP or (answer.verdict == RISE) == (member in holding):
                continue
            finding = Finding(member, answer.verdict, question.stamp, question.received, answer.detail, answer.causes)
            found += self._take([finding])
        for agent in sorted(agents):
            found += self._mature(agent, question.stamp, question.received)
        return found

    def follow(self, edges: Sequence[Edge]) -> list[Edge]:
        """The edges that those of its parts cause."""
        assert isinstance(self.condition, CombinationCondition)
        found: list[Edge] = []
        for together in self.condition.moments(edges):
            found += self._take(self.condition.follow(together))
        return found

    def elapse(self, now: int) -> list[Edge]:
        """The edges that the time alone causes, up to `now` on this machine's clock."""
        found: list[Edge] = []
        for agent in self._unseen - self._seen.keys():
            found += self._hear(agent, now, now)
        self._unseen.clear()
        for (agent,) in list(self._silences.passed(now)):
            end = self._end((agent,))
            found += self._pass(end, now) if end is not None and self._ends is not None else []
            found += self._expire(agent, now) if agent in self._seen else []
        found += self._take(self.condition.elapse(now))
        beginning = self.occurrences.beginning(now) if self._ends is not None else None
        found += self._pass(beginning, now) if beginning is not None else []
        return found + self.occurrences.elapse(now)

    def due(self) -> int | None:
        """When `elapse` may have something to say."""
        if self._unseen:
            return 0
        return earliest((self._silences.due(), self.condition.due(), self.occurrences.due()))

    def adopt(self, edge: Edge) -> bool:
        """Take over an event that began earlier; False when the rule cannot have it or has it already."""
        agents = self.occurrences.adopt(edge)
        if agents is None:
            return False
        if not self.occurrences.provisional:
            self.condition.mark(agents, True)
            self._unseen |= set(agents) if self._expire_ns else set()
        return True

    def restart(self, agent: str, stamp: int) -> None:
        """The agent's time begins anew."""
        self._seen.pop(agent, None)
        self._slots.pop(agent, None)
        self.condition.forget(agent)
        self.occurrences.restart(agent, stamp)

    def _ask(self, reading: Reading) -> None:
        repeated = bool(self._every_ns) and self._repeated(reading.agent, reading.stamp)
        if isinstance(self.condition, PluginCondition):
            self.condition.show(reading, not repeated)
        elif not repeated:
            self.condition.observe(reading)

    def _hear(self, agent: str, stamp: int, received: int) -> list[Edge]:
        """Note that an agent was heard of; its events end first when it was silent for too long."""
        found: list[Edge] = []
        if self._expire_ns:
            for other in [agent, *self.condition.partners(agent)]:
                if other in self._seen and stamp - self._seen[other][0] > self._expire_ns:
                    found += self._expire(other, received)
        if agent not in self._seen and len(self._seen) >= AGENTS_MAX:
            self.ignored += 1
            return found
        self._seen[agent] = (stamp, received)
        if self._expire_ns:
            self._silences.watch((agent,), received + self._expire_ns + GRACE_NS)
        if self._ends is not None:
            self._ends.watch((agent,), stamp + self._expire_ns)
        return found

    def _pass(self, stamp: int, received: int) -> list[Edge]:
        """A group has one time: whose silence was too long up to `stamp` has left it before anything later counts, in
        the order of stamps, whoever is heard of and whenever the clock is looked at."""
        if self._ends is None or not (gone := [agent for (agent,) in self._ends.passed(stamp)]):
            return []
        ordered = sorted(gone, key=lambda agent: (self._seen[agent][0], agent))
        return [edge for agent in ordered for edge in self._expire(agent, received)]

    def _expire(self, agent: str, now: int) -> list[Edge]:
        gone = sorted(member for member in self.condition.holding if agent in member)
        ends = [min(self._seen[one][0] for one in member if one in self._seen) + self._expire_ns for member in gone]
        del self._seen[agent]
        self._slots.pop(agent, None)
        self.condition.forget(agent)
        return self._take([Finding(member, FALL, end, now) for member, end in zip(gone, ends, strict=True)])

    def _end(self, member: Member) -> int | None:
        """When the agent's silence is too long, in its own time."""
        last = self._seen.get(member[0])
        return None if last is None else last[0] + self._expire_ns

    def _silent_at(self, member: Member) -> int | None:
        last = self._seen.get(member[0])
        return None if last is None else last[1] + self._expire_ns + GRACE_NS

    def _repeated(self, agent: str, stamp: int) -> bool:
        """Whether the agent has been looked at in this span of time."""
        slot = stamp // self._every_ns
        repeated = self._slots.get(agent) == slot
        self._slots[agent] = slot
        return repeated

    def _take(self, findings: Iterable[Finding]) -> list[Edge]:
        found: list[Edge] = []
        for finding in findings:
            self.condition.mark(finding.member, finding.verdict == RISE)
            found += self.occurrences.take(finding)
        return found

    def _mature(self, agent: str, stamp: int, received: int) -> list[Edge]:
        """Begin what has held for long enough for all of its agents."""
        found: list[Edge] = []
        for agents in self.occurrences.waiting(agent):
            found += self.occurrences.mature(agents, self._progress(agents, stamp), received)
        return found

    def _progress(self, agents: Agents, stamp: int) -> int:
        if self.rule.scope == GROUP:
            return stamp
        return min((self._seen[agent][0] for agent in agents if agent in self._seen), default=stamp)
