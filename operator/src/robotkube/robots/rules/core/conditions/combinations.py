"""Combinations of rules: conditions on the edges of other rules, without messages of their own.

A part holds for a member when it has an event whose agents are among the member's, or the other way round: an event
of a pair says something about each of the two, and an event of one about every pair he belongs to. An event of a
group, or of a rule that always holds, counts for everybody.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations, groupby
from operator import attrgetter

from robotkube.robots.rules.core.conditions.levels import RuleCondition
from robotkube.robots.rules.core.events import START, Cause, Edge
from robotkube.robots.rules.core.messages import FALL, RISE, Agents, Member, MemberChange, MessageValues
from robotkube.robots.rules.core.specification.consistency import universal
from robotkube.robots.rules.core.specification.specifications import ALL, GROUP, PAIR, SEQUENCE, Combination, Part, Rule

STARTS_MAX = 10_000
"""The starts of a sequence's part that are remembered."""
STATIC_AGENTS_MAX = 100
CAUSES_MAX = 8


_stamp = attrgetter("stamp")


class CombinationCondition(RuleCondition):
    """A condition on other rules: all, any, or one after the other. `rules`: the parts' rules by name."""

    def __init__(self, rule: Rule, settings: Combination, rules: Mapping[str, Rule]) -> None:
        super().__init__()
        self._rule = rule
        self._settings = settings
        self.names = frozenset(part.rule for part in settings.parts)
        self._everybody = {name for name in self.names if universal(rules[name])}
        self._active: dict[str, dict[Agents, Edge]] = {name: {} for name in self.names}
        self._starts: list[deque[tuple[int, Agents]]] = [deque(maxlen=STARTS_MAX) for _ in settings.parts]

    def observe(self, reading: MessageValues) -> Sequence[MemberChange]:
        """Nothing: messages do not change a combination."""
        return ()

    def begin(self, stamp: int, received: int) -> Sequence[MemberChange]:
        """The changes before the first event: parts that must not hold do not."""
        if self._settings.mode == SEQUENCE:
            return ()
        listed = [()] if self._rule.scope == GROUP else self._listed()
        return [
            MemberChange(member, RISE, stamp, received)
            for member in listed
            if member not in self.holding and self._holds(member)
        ]

    def moments(self, edges: Sequence[Edge], at_once: bool = False) -> list[list[Edge]]:
        """The edges of one message or one tick, grouped by moment (`at_once`: all of them are one): a message that
        begins one part and ends another must not show what holds in between. Of a sequence the order counts, so each
        edge is a group."""
        ordered = sorted(edges, key=_stamp)
        if self._settings.mode == SEQUENCE:
            return [[edge] for edge in ordered]
        if at_once:
            return [ordered] if ordered else []
        return [list(together) for _, together in groupby(ordered, key=_stamp)]

    def follow(self, edges: Sequence[Edge]) -> list[MemberChange]:
        """The changes that edges of one moment cause."""
        for edge in edges:
            if edge.edge == START:
                self._active[edge.rule][edge.agents] = edge
            else:
                self._active[edge.rule].pop(edge.agents, None)
        if self._settings.mode == SEQUENCE:
            return [change for edge in edges for change in self._sequence(edge)]
        last = {member: edge for edge in edges for member in self._concerned(edge)}
        changes = []
        for member, edge in last.items():
            holds = self._holds(member)
            if holds != (member in self.holding):
                changes.append(self._member_change(member, RISE if holds else FALL, edge))
        return changes

    def _holds(self, member: Member) -> bool:
        truths = (self._part_holds(part, member) for part in self._settings.parts)
        return all(truths) if self._settings.mode == ALL else any(truths)

    def _part_holds(self, part: Part, member: Member) -> bool:
        return any(self._about(part.rule, agents, member) for agents in self._active[part.rule]) != part.negated

    def _about(self, name: str, agents: Agents, member: Member) -> bool:
        if name in self._everybody or not member:
            return True
        mine, theirs = set(member), set(agents)
        return mine <= theirs or theirs <= mine

    def _concerned(self, edge: Edge) -> Collection[Member]:
        """The members that an edge may concern."""
        if self._rule.scope == GROUP:
            return [()]
        known = dict.fromkeys([*self._known(edge), *self.holding, *self._listed()])
        return [member for member in known if self._about(edge.rule, edge.agents, member)]

    def _known(self, edge: Edge) -> Iterator[Member]:
        """The members that the parts' events name."""
        names = [name for name in self.names if name not in self._everybody]
        events = [edge.agents] if edge.rule not in self._everybody and self._rule.scope != PAIR else None
        for agents in events or [agents for name in names for agents in (*self._active[name], *self._own(name, edge))]:
            yield from self._members(agents)

    def _own(self, name: str, edge: Edge) -> Sequence[Agents]:
        return [edge.agents] if edge.rule == name else []

    def _members(self, agents: Agents) -> Iterator[Member]:
        pairs = [agents] if len(agents) == 2 else []
        members = pairs if self._rule.scope == PAIR else [(agent,) for agent in agents]
        allowed = set(self._rule.agents)
        yield from (member for member in members if not allowed or set(member) <= allowed)

    def _listed(self) -> Sequence[Member]:
        agents = sorted(self._rule.agents)[:STATIC_AGENTS_MAX]
        return list(combinations(agents, 2)) if self._rule.scope == PAIR else [(agent,) for agent in agents]

    def _sequence(self, edge: Edge) -> Iterator[MemberChange]:
        parts = self._settings.parts
        if edge.edge != START:
            if edge.rule == parts[-1].rule:
                for member in [member for member in self.holding if self._about(edge.rule, edge.agents, member)]:
                    if not self._part_holds(parts[-1], member):
                        yield self._member_change(member, FALL, edge)
            return
        if edge.rule == parts[-1].rule:
            members = [()] if self._rule.scope == GROUP else list(self._members(edge.agents))
            for member in members:
                if member not in self.holding and self._complete(member, edge.stamp):
                    yield self._member_change(member, RISE, edge)
        for part, starts in zip(parts, self._starts, strict=True):
            if part.rule == edge.rule:
                starts.append((edge.stamp, edge.agents))

    def _complete(self, member: Member, stamp: int) -> bool:
        """Return whether the earlier parts began one after the other before `stamp`, all within the time.

        The search goes backwards and takes each start as late as can be."""
        bound = stamp
        for part, starts in reversed(list(zip(self._settings.parts, self._starts, strict=True))[:-1]):
            earlier = [at for at, agents in starts if at < bound and self._about(part.rule, agents, member)]
            if not earlier:
                return False
            bound = max(earlier)
        return stamp - bound <= int(self._settings.within_seconds * 1e9)

    def _member_change(self, member: Member, verdict: int, edge: Edge) -> MemberChange:
        causes: list[Cause] = list(edge.causes)
        for part in self._settings.parts:
            for agents, active in self._active[part.rule].items():
                if active is not edge and self._about(part.rule, agents, member):
                    causes += active.causes
        return MemberChange(member, verdict, edge.stamp, edge.time, edge.detail, tuple(causes[:CAUSES_MAX]))
