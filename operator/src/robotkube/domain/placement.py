"""Which agent a service runs on, with the reason for every candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from robotkube.domain.catalogue_applications import PlacementRule
from robotkube.domain.errors import RefusalError


@dataclass(frozen=True, order=True)
class Agent:
    """A declared machine of the fleet; its node may not exist yet."""

    name: str
    role: str
    namespace: str


@dataclass(frozen=True)
class NodeState:
    """A Node that belongs to an agent (label robotkube.io/agent)."""

    name: str
    agent: str
    role: str
    capabilities: frozenset[str]
    ready: bool
    cordoned: bool = False


@dataclass(frozen=True)
class Seat:
    """An instance of a service that needs a place: its rule, the agent it names (rendered; None when it names none),
    and the agents that run its release already."""

    service: str
    rule: PlacementRule
    agent: object = None
    kept: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Placement:
    """The agent chosen, and one sentence per candidate."""

    agent: Agent
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Fleet:
    """Declared agents and their nodes."""

    agents: Mapping[str, Agent]
    nodes: Mapping[str, tuple[NodeState, ...]]

    def present(self, role: str) -> tuple[Agent, ...]:
        """Declared agents of a role that have a node, by name."""
        return tuple(a for name, a in sorted(self.agents.items()) if a.role == role and self.nodes.get(name))

    def agent(self, name: object) -> Agent:
        """A declared agent that has a node; RefusalError(NoCapableNode) says which of both it lacks."""
        if not isinstance(name, str) or name not in self.agents:
            raise RefusalError("NoCapableNode", f"agent {name!r} is not declared in the platform's values")
        if not self.nodes.get(name):
            raise RefusalError("NoCapableNode", f"agent {name!r} has no Node with label robotkube.io/agent={name}")
        return self.agents[name]


def fleet(agents: Sequence[Agent], nodes: Sequence[NodeState]) -> Fleet:
    """Agents and nodes by agent name."""
    by_agent: dict[str, list[NodeState]] = {}
    for node in sorted(nodes, key=lambda n: n.name):
        by_agent.setdefault(node.agent, []).append(node)
    return Fleet({a.name: a for a in agents}, {name: tuple(found) for name, found in by_agent.items()})


def place(seats: Sequence[Seat], fleet: Fleet, load: Mapping[str, int]) -> Placement:
    """The one agent for services that share a node.

    A named agent is taken; else the agents of the role that is asked for, or all, are candidates. One that runs most of
    the releases already stays, even when it is not ready at the moment. Else the one with the least `load` (releases
    placed so far), then the first by name. RefusalError(NoCapableNode) gives every candidate's reason.
    """
    named = _named(seats, fleet)
    if named and len(seats) == 1:
        return Placement(named, (f"{named.name}: named by the application",))
    role = _one_role(seats)
    candidates = [named] if named else [a for _, a in sorted(fleet.agents.items()) if role in ("", a.role)]
    kept = {agent.name: sum(agent.name in seat.kept for seat in seats) for agent in candidates}
    present = {agent.name for agent in candidates if kept[agent.name] or agent == named}
    obstacles = {a.name: _obstacle(seats, a, fleet.nodes.get(a.name, ()), a.name in present) for a in candidates}
    free = [agent for agent in candidates if not obstacles[agent.name]]
    if not free:
        detail = "; ".join(f"{name}: {text}" for name, text in obstacles.items()) or "no agent of that role is declared"
        raise RefusalError("NoCapableNode", f"no agent for {_wanted(seats)}: {detail}")
    chosen = min(free, key=lambda a: (-kept[a.name], load.get(a.name, 0), a.name))
    reasons = [_reason(a, obstacles[a.name], chosen, kept[a.name], load.get(a.name, 0)) for a in candidates]
    return Placement(chosen, (*_together(seats), *reasons))


def _named(seats: Sequence[Seat], fleet: Fleet) -> Agent | None:
    agents = [(seat.service, fleet.agent(seat.agent)) for seat in seats if seat.agent is not None]
    if len({agent for _, agent in agents}) > 1:
        text = ", ".join(f"{service} names {agent.name}" for service, agent in agents)
        raise RefusalError("NoCapableNode", f"services with ros links must share a node: {text}")
    return agents[0][1] if agents else None


def _one_role(seats: Sequence[Seat]) -> str:
    roles = {seat.service: seat.rule.role for seat in seats if seat.rule.role}
    if len(set(roles.values())) > 1:
        text = ", ".join(f"{service} wants role {role}" for service, role in roles.items())
        raise RefusalError("NoCapableNode", f"services with ros links must share a node: {text}")
    return next(iter(roles.values()), "")


def _wanted(seats: Sequence[Seat]) -> str:
    role = _one_role(seats)
    words = [f"role {role}"] if role else []
    words += [f"capability {c}" for c in _capabilities(seats)]
    return " ".join([*(words or ["any role"]), *(f"({text})" for text in _together(seats))])


def _capabilities(seats: Sequence[Seat]) -> Sequence[str]:
    return list(dict.fromkeys(c for seat in seats for c in seat.rule.capabilities))


def _together(seats: Sequence[Seat]) -> Sequence[str]:
    names = dict.fromkeys(seat.service for seat in seats)
    return [f"{', '.join(names)}: on one node, linked by ros"] if len(seats) > 1 else []


def _obstacle(seats: Sequence[Seat], agent: Agent, nodes: Sequence[NodeState], stays: bool) -> str:
    role = _one_role(seats)
    if role not in ("", agent.role):
        return f"has role {agent.role}, not {role}"
    if not nodes:
        return "has no Node"
    missing = [c for c in _capabilities(seats) if not any(c in node.capabilities for node in nodes)]
    if missing:
        return f"lacks capability {', '.join(missing)}"
    if stays or any(node.ready and not node.cordoned for node in nodes):
        return ""
    return "no Node is Ready and schedulable"


def _reason(agent: Agent, obstacle: str, chosen: Agent, kept: int, load: int) -> str:
    if obstacle:
        return f"{agent.name}: {obstacle}"
    if agent == chosen:
        return f"{agent.name}: taken, {'it runs there already' if kept else f'{load} releases placed'}"
    return f"{agent.name}: possible, {load} releases placed"
