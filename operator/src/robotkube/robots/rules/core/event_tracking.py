"""The events of a rule from its changes: sustained time, minimum interval, cooldown, groups and adoption."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, replace

from robotkube.robots.rules.core.conditions.levels import GRACE_NS, Timers
from robotkube.robots.rules.core.events import START, STOP, Edge, event_identity
from robotkube.robots.rules.core.messages import FALL, NEVER, RISE, Agents, Member, MemberChange
from robotkube.robots.rules.core.specification.specifications import GROUP, PAIR, Combination, Rule

ADOPTED_NS = 60_000_000_000
IDLE_MAX = 10_000
"""The most agents (or pairs) whose last event is remembered, for cooldown and minimum interval."""


@dataclass(slots=True)
class _State:
    """The state of one event's agents: since when the condition holds, the event that lasts, the last one's begin and
    end."""

    since: MemberChange | None = None
    active: Edge | None = None
    stamp: int = NEVER
    started: int | None = None
    stopped: int | None = None


class EventTracker:
    """The events of one rule, from changes to edges. `pending`: the agents for whom it holds, but is no event yet."""

    def __init__(self, rule: Rule) -> None:
        self.rule = rule
        timing = rule.timing
        self._sustained = int(timing.sustained * 1e9)
        self._cooldown = int(timing.cooldown * 1e9)
        self._interval = int(timing.minimum_interval * 1e9)
        self._states: dict[Agents, _State] = {}
        self._idle: OrderedDict[Agents, _State] = OrderedDict()
        self.pending: set[Agents] = set()
        self._members: set[Member] = set()
        self._group: Agents = tuple(sorted(rule.agents))  # (): whoever it holds for when an event begins
        self._adopted: dict[Agents, int | None] = {}
        self._timers = Timers(self._moment)

    @property
    def active(self) -> tuple[Edge, ...]:
        """The start edges of the events that last; any thread may read it."""
        return tuple(edge for state in list(self._states.values()) if (edge := state.active) is not None)

    @property
    def provisional(self) -> bool:
        """Return whether an event that is taken over has to prove itself, because its members or parts are not known
        any more."""
        return self.rule.scope == GROUP or isinstance(self.rule.condition, Combination)

    def adopt(self, edge: Edge) -> Agents | None:
        """Take over an event that began earlier; its agents, or None when the rule cannot have it or has one already.

        Of a group or a combination neither members nor parts are taken over: it ends when they have not shown
        themselves within a minute.
        """
        agents = tuple(sorted(edge.agents))
        key = self._group if self.rule.scope == GROUP else agents
        if key in self._states or not self._fits(agents):
            return None
        started = replace(edge, edge=START, rule=self.rule.name)
        self._states[key] = _State(active=started, stamp=edge.stamp, started=edge.stamp)
        if self.provisional:
            self._adopted[key] = None
        return agents

    def apply(self, change: MemberChange) -> list[Edge]:
        """The edges that a change causes for its member's event, or for the group's."""
        if self.rule.scope != GROUP:
            return self._change(change.member, change)
        edges = self.mature(self._group, change.stamp - 1, change.received)  # with those for whom it held until then
        before = len(self._members) >= self.rule.at_least
        if change.verdict == RISE:
            self._members.add(change.member)
        else:
            self._members.discard(change.member)
        holds = len(self._members) >= self.rule.at_least
        if holds != before:
            edges += self._change(self._group, change._replace(verdict=RISE if holds else FALL))
        return edges

    def mature(self, agents: Agents, stamp: int, received: int) -> list[Edge]:
        """The start of an event whose time has come at `stamp`, the agents' common progress."""
        state = self._states.get(agents)
        if agents not in self.pending or state is None or state.since is None:
            return []
        beginning = self._beginning(state)
        return [self._start(agents, state, beginning, received)] if beginning <= stamp else []

    def waiting(self, agent: str) -> Iterable[Agents]:
        """The agents, with this one among them, whose event has still to begin."""
        group = self.rule.scope == GROUP
        return [agents for agents in self.pending if group or agent in agents] if self.pending else ()

    def beginning(self, now: int) -> int | None:
        """The stamp at which the group's event begins by the time alone; None until that moment on this machine's
        clock."""
        moment = self._moment(self._group)
        return None if moment is None or moment > now else self._beginning(self._states[self._group])

    def elapse(self, now: int) -> list[Edge]:
        """The edges of events that begin by the time alone, up to `now` on this machine's clock."""
        edges = []
        for agents in list(self._timers.passed(now)):
            state = self._states[agents]
            edges.append(self._start(agents, state, self._beginning(state), now))
        for agents, until in list(self._adopted.items()):
            if until is None:
                self._adopted[agents] = now + ADOPTED_NS
            elif until <= now:
                edges += self._change(agents, MemberChange(agents, FALL, now, now))
        return edges

    def due(self) -> int | None:
        """The next moment at which `elapse` may give edges; None without one."""
        if self._adopted:
            return min(until or 0 for until in self._adopted.values())
        return self._timers.due()

    def in_doubt(self, stamp: int) -> bool:
        """Return whether an event may still begin at `stamp` or before it."""
        return any(self._beginning(self._states[agents]) <= stamp for agents in self.pending)

    def restart(self, agent: str, stamp: int) -> None:
        """Begin an agent's time anew at `stamp`: its events forget the old time."""
        for states in (self._states, self._idle):
            for agents, state in states.items():
                if agent in agents or not agents:
                    state.stamp = stamp
                    state.started = None
                    state.stopped = None
                    if state.since is not None:
                        state.since = state.since._replace(stamp=stamp)

    def _fits(self, agents: Agents) -> bool:
        if self.rule.scope == GROUP:
            return bool(agents) and self._group in ((), agents)
        known = not self.rule.agents or set(agents) <= set(self.rule.agents)
        return known and len(agents) == (2 if self.rule.scope == PAIR else 1)

    def _change(self, agents: Agents, change: MemberChange) -> list[Edge]:
        state = self._states.get(agents)
        if state is None:
            state = self._states[agents] = self._idle.pop(agents, _State())
        stamp = max(state.stamp, change.stamp)
        change = change._replace(stamp=stamp)
        self._adopted.pop(agents, None)
        if change.verdict != RISE:
            return self._cease(agents, state, change)
        state.stamp = stamp
        if state.since is None:
            state.since = change
        if state.active is not None:
            return []
        beginning = self._beginning(state)
        if beginning <= stamp:
            return [self._start(agents, state, beginning, change.received)]
        self.pending.add(agents)
        self._timers.watch(agents, change.received + beginning - stamp + GRACE_NS)
        return []

    def _cease(self, agents: Agents, state: _State, change: MemberChange) -> list[Edge]:
        edges = self.mature(agents, change.stamp - 1, change.received)
        self.pending.discard(agents)
        if state.active is not None:
            distance = change.detail.get("distance_m")
            causes = change.causes
            detail = change.detail
            edge = replace(state.active, edge=STOP, time=change.received, stamp=change.stamp)
            edges.append(replace(edge, distance_m=distance, causes=causes, detail=detail))
            state.stopped = change.stamp
        state.since = None
        state.active = None
        state.stamp = change.stamp
        self._states.pop(agents, None)
        if state.started is not None:
            self._idle[agents] = state
            if len(self._idle) > IDLE_MAX:
                self._idle.popitem(last=False)
        return edges

    def _beginning(self, state: _State) -> int:
        """The stamp at which the event may begin; two events of the same agents never begin at one stamp."""
        assert state.since is not None
        beginning = state.since.stamp + self._sustained
        if state.started is not None:
            beginning = max(beginning, state.started + max(self._interval, 1))
        return beginning if state.stopped is None else max(beginning, state.stopped + self._cooldown)

    def _start(self, agents: Agents, state: _State, beginning: int, received: int) -> Edge:
        assert state.since is not None
        named = agents or self._holders()
        event, trace = event_identity(self.rule.name, named, beginning)
        detail = state.since.detail
        causes = state.since.causes
        state.active = Edge(
            self.rule.name, START, named, event, trace, received, beginning, detail.get("distance_m"), causes, detail
        )
        state.started = beginning
        state.stamp = max(state.stamp, beginning)
        self.pending.discard(agents)
        return state.active

    def _holders(self) -> Agents:
        """The agents for whom it holds now: those of a group's event when the rule lists none."""
        return tuple(sorted({agent for member in self._members for agent in member}))

    def _moment(self, agents: Agents) -> int | None:
        """The moment at which the event begins on this machine's clock, if no message changes it; None without one."""
        state = self._states.get(agents)
        if agents not in self.pending or state is None or state.since is None:
            return None
        return state.since.received + self._beginning(state) - state.since.stamp + GRACE_NS
